"""Worlds of different looks on one page: colours, sizes and meshes that are each world's own."""

from __future__ import annotations

from typing import Any, cast

import mujoco
import numpy as np
import viser
from mjviser import ViserMujocoScene

from mjlab_viewer.host_world import HostWorld, copy_world
from mjlab_viewer.snapshot import Snapshot

_VISUAL = """geom_rgba geom_size geom_pos geom_quat geom_dataid geom_matid mat_rgba site_pos site_quat""".split()


def look(snapshot: Snapshot, row: int) -> bytes:
  """What tells the look of a world from that of another; empty where all look alike."""
  return b"".join(snapshot.model[name][row].tobytes() for name in _VISUAL if name in snapshot.model)


class Wardrobe:
  """Bodies of worlds that look different from the selected one.

  mjviser bakes one look for all worlds, so every further look is a scene of its own, under a node of its own. Scenes
  are kept and dressed anew when a look changes; there are never more than worlds shown.

  Args:
    server: Where.
    model: The simulation's model; copied.
  """

  def __init__(self, server: viser.ViserServer, model: mujoco.MjModel) -> None:
    self._server, self._model = server, model
    self.scenes: list[Dressed] = []

  def show(
    self, snapshot: Snapshot, rows: dict[bytes, list[int]], poses: dict[str, np.ndarray], template: ViserMujocoScene
  ) -> None:
    """Show rows of a snapshot by their look, at `poses`, whose groups are visible as those of `template` are."""
    while len(self.scenes) < len(rows):
      self.scenes.append(Dressed(self._server, self._model, f"/look{len(self.scenes)}"))
    free = [scene for scene in self.scenes if scene.look not in rows]
    by_look = {scene.look: scene for scene in self.scenes if scene.look in rows}
    for key, chosen in rows.items():
      scene = by_look.get(key) or free.pop()
      scene.show(snapshot, key, chosen, poses, template)
    for scene in free:
      scene.root.visible = False


class Dressed:
  """Bodies of one look."""

  def __init__(self, server: viser.ViserServer, model: mujoco.MjModel, path: str) -> None:
    self.look: bytes | None = None
    self.root = server.scene.add_frame(path, show_axes=False)
    self._own = HostWorld(model)
    under: Any = _ServerUnder(server, path)
    self.scene = ViserMujocoScene(cast(viser.ViserServer, under), self._own.model, 1)
    self.scene.camera_tracking_enabled = False
    # What does not move is shown once, by the scene of the selected world.
    self.scene.fixed_bodies_frame.visible = False

  def show(
    self,
    snapshot: Snapshot,
    key: bytes,
    rows: list[int],
    poses: dict[str, np.ndarray],
    template: ViserMujocoScene,
  ) -> None:
    scene = self.scene
    if key != self.look:
      self.look = key
      copy_world(snapshot, rows[0], self._own.model, scene.mj_data)
      scene.rebuild_visual_handles()
    geoms, sites = template.geom_groups_visible, template.site_groups_visible
    if (scene.geom_groups_visible, scene.site_groups_visible) != (geoms, sites):
      scene.geom_groups_visible, scene.site_groups_visible = list(geoms), list(sites)
      # mjviser does this behind its own check boxes only.
      scene._sync_visibilities()
    self.root.visible = True
    scene.update_from_arrays(**{name: values[rows] for name, values in poses.items()}, env_idx=0)


class _SceneUnder:
  """viser's scene with every node that is added under a path."""

  def __init__(self, scene: viser.SceneApi, path: str) -> None:
    self._scene, self._path = scene, path

  def __getattr__(self, name: str) -> Any:
    attribute = getattr(self._scene, name)
    if not name.startswith("add_"):
      return attribute
    return lambda path, *args, **kwargs: attribute(self._path + path, *args, **kwargs)


class _ServerUnder:
  """viser's server with such a scene."""

  def __init__(self, server: viser.ViserServer, path: str) -> None:
    self._server = server
    self.scene = _SceneUnder(server.scene, path)

  def __getattr__(self, name: str) -> Any:
    return getattr(self._server, name)
