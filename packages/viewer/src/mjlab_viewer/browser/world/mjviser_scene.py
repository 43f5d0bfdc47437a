"""Scene of mjviser, and all uses of its private names.

`PRIVATE_NAMES` lists them with their reasons. They are tested with mjviser 0.0.14, and the requirement allows no later
minor version. Where a name is missing, the page works without its feature.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import trimesh
import viser
from mjviser import ViserMujocoScene, conversions

TESTED_VERSION = "0.0.14"
PRIVATE_NAMES = {
  "_update_decor_from_mjvscene": "mjviser draws contacts that it computes itself; the simulation's are drawn instead",
  "_tracked_body_id": "mjviser follows the first body that moves, and has no public way to choose another",
  "_sync_visibilities": "mjviser applies visible groups only behind its own check boxes",
  "_mjv_option": "it has no public flags for split contact forces and for visible groups of joints",
}
"""Private names of `ViserMujocoScene` that are used here, with the reason."""
PRIVATE_FUNCTIONS = {"_can_merge_vertices": "compares colors in Python, a tenth of the time until a page opens"}
"""Private functions of `mjviser.conversions` that are replaced here, with the reason."""


def _can_merge_vertices(mesh: trimesh.Trimesh) -> bool:
  """Return True if vertices at one place have one color.

  It replaces mjviser's function of this name, which compares colors in Python; that was a tenth of the time until the
  page of `demo` opens.
  """
  colors = getattr(mesh.visual, "vertex_colors", None)
  if colors is None or (colors == colors[:1]).all():
    return True
  _, first, place = np.unique(np.round(mesh.vertices, 6), axis=0, return_index=True, return_inverse=True)
  return bool((colors == colors[first[place]]).all())


setattr(conversions, _can_merge_vertices.__name__, _can_merge_vertices)


class MujocoScene(ViserMujocoScene):
  """Scene that leaves contacts to its user, and offers what mjviser keeps private."""

  def _update_decor_from_mjvscene(self, mj_data: mujoco.MjData, scene_offset: np.ndarray) -> None:
    mj_data.ncon = 0
    super()._update_decor_from_mjvscene(mj_data, scene_offset)

  def track(self, body: int | None) -> None:
    """Keep a body at the origin of the page; with None, keep the camera where it is."""
    self.camera_tracking_enabled = body is not None
    if body is not None and hasattr(self, "_tracked_body_id"):
      self._tracked_body_id = body

  def show_groups(self, geoms: list[bool], sites: list[bool]) -> None:
    """Show only these groups of geoms and sites."""
    if (self.geom_groups_visible, self.site_groups_visible) == (geoms, sites):
      return
    self.geom_groups_visible, self.site_groups_visible = list(geoms), list(sites)
    if hasattr(self, "_sync_visibilities"):
      self._sync_visibilities()
    else:
      # Public, and slower.
      self.rebuild_visual_handles()

  def overlay_groups(self, kind: str) -> np.ndarray | None:
    """Return the groups of "Joints", "Tendons" or "Actuators" that overlays show, to be written to, (6,)."""
    option: Any = getattr(self, "_mjv_option", None)
    return None if option is None else getattr(option, f"{kind.lower().removesuffix('s')}group")

  @property
  def splits_contact_forces(self) -> bool:
    """True if the user wants normal force and friction as two arrows."""
    option: Any = getattr(self, "_mjv_option", None)
    return option is not None and bool(option.flags[mujoco.mjtVisFlag.mjVIS_CONTACTSPLIT])


class _SceneUnder:
  """viser's scene with every node that is added under a path, and without environment maps.

  The page is almost invisible until the browser has loaded a map, and stays so if it cannot.
  """

  def __init__(self, scene: viser.SceneApi, path: str) -> None:
    self._scene, self._path = scene, path

  def __getattr__(self, name: str) -> Any:
    if name == "configure_environment_map":
      return lambda **_: None
    attribute = getattr(self._scene, name)
    if not name.startswith("add_"):
      return attribute
    return lambda path, *args, **kwargs: attribute(self._path + path, *args, **kwargs)


class ServerUnder:
  """viser's server, with a scene that adds every node under a path and has no environment map."""

  def __init__(self, server: viser.ViserServer, path: str) -> None:
    self._server = server
    self.scene = _SceneUnder(server.scene, path)

  def __getattr__(self, name: str) -> Any:
    return getattr(self._server, name)
