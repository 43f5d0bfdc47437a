"""Worlds with different colors, sizes and meshes on one page."""

from __future__ import annotations

from typing import Any, cast

import mujoco
import numpy as np
import viser

from mjlab_viewer.browser.world.mjviser_scene import MujocoScene, ServerUnder
from mjlab_viewer.snapshot import HostWorld, Snapshot, copy_world

_VISUAL = """geom_rgba geom_size geom_pos geom_quat geom_dataid geom_matid mat_rgba site_pos site_quat""".split()


def appearance_key(snapshot: Snapshot, row: int) -> bytes:
  """Return a key that worlds of the same appearance share; empty if all worlds are alike."""
  return b"".join(snapshot.model[name][row].tobytes() for name in _VISUAL if name in snapshot.model)


class OtherAppearances:
  """Bodies of worlds that do not look like the selected one.

  mjviser shows all worlds alike, so each further appearance has a separate scene under a separate node. Scenes are
  reused when an appearance changes; there are never more than worlds shown.

  Args:
    server: Server of the page.
    model: The simulation's model; copied.
  """

  def __init__(self, server: viser.ViserServer, model: mujoco.MjModel) -> None:
    self._server, self._model = server, model
    self.scenes: list[AppearanceScene] = []

  def show(
    self, snapshot: Snapshot, rows: dict[bytes, list[int]], poses: dict[str, np.ndarray], template: MujocoScene
  ) -> None:
    """Show rows of a snapshot by their appearance, at `poses`, with the visible groups of `template`."""
    while len(self.scenes) < len(rows):
      self.scenes.append(AppearanceScene(self._server, self._model, f"/appearance{len(self.scenes)}"))
    free = [scene for scene in self.scenes if scene.key not in rows]
    by_key = {scene.key: scene for scene in self.scenes if scene.key in rows}
    for key, chosen in rows.items():
      scene = by_key.get(key) or free.pop()
      scene.show(snapshot, key, chosen, poses, template)
    for scene in free:
      scene.root.visible = False


class AppearanceScene:
  """Bodies of one appearance."""

  def __init__(self, server: viser.ViserServer, model: mujoco.MjModel, path: str) -> None:
    self.key: bytes | None = None
    self.root = server.scene.add_frame(path, show_axes=False)
    self._own = HostWorld(model)
    under: Any = ServerUnder(server, path)
    self.scene = MujocoScene(cast(viser.ViserServer, under), self._own.model, 1)
    self.scene.track(None)
    # Bodies that do not move are shown once, by the scene of the selected world.
    self.scene.fixed_bodies_frame.visible = False

  def show(
    self, snapshot: Snapshot, key: bytes, rows: list[int], poses: dict[str, np.ndarray], template: MujocoScene
  ) -> None:
    """Show rows of a snapshot, all of this appearance."""
    if key != self.key:
      self.key = key
      copy_world(snapshot, rows[0], self._own.model, self.scene.mj_data)
      self.scene.rebuild_visual_handles()
    self.scene.show_groups(template.geom_groups_visible, template.site_groups_visible)
    self.root.visible = True
    self.scene.update_from_arrays(**{name: values[rows] for name, values in poses.items()}, env_idx=0)
