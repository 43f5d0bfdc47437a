"""Extent of objects: exact for primitives, the bounding box for meshes."""

from typing import TYPE_CHECKING, Any

import mujoco
import torch
from mjlab_core import MjlabError, matrix_from_quat
from mjlab_scene import Entity, VariantEntity

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

_G = mujoco.mjtGeom
_BOX, _ROUND = torch.eye(3), torch.zeros(3, 3)
_ROUND[0] = 1.0
_ROD, _DISC = torch.zeros(3, 3), torch.zeros(3, 3)
_ROD[1, 2] = _DISC[0, 0] = _DISC[0, 1] = 1.0
_NOTHING = torch.zeros(3, 3)

# A primitive is the sum of a box and an ellipsoid. Rows are its sizes, columns the half edges and the semi-axes.
_SHAPES = {
  int(_G.mjGEOM_SPHERE): (_NOTHING, _ROUND),
  int(_G.mjGEOM_CAPSULE): (_ROD, _ROUND),
  int(_G.mjGEOM_CYLINDER): (_ROD, _DISC),
  int(_G.mjGEOM_ELLIPSOID): (_NOTHING, _BOX),
  int(_G.mjGEOM_BOX): (_BOX, _NOTHING),
  int(_G.mjGEOM_MESH): (_NOTHING, _NOTHING),
}


class Extent:
  """Extent of an object of one body in each world, for its present geoms and sizes.

  Raises:
    MjlabError: There are several bodies, or a world without a geom.
  """

  def __init__(self, env: "ManagerBasedRlEnv", entity: Entity) -> None:
    self._sim, model, ids = env.sim, env.sim.mj_model, entity.indexing.ids["geom"]
    if len(set(model.geom_bodyid[ids].tolist())) != 1:
      raise MjlabError(f"entity '{entity.name}' must have its geoms on one body")
    like: dict[str, Any] = {"device": env.device, "dtype": env.sim.dtype}
    self._geoms = entity.indexing.index["geom"]
    edges, axes = zip(*(_SHAPES[int(model.geom_type[geom])] for geom in ids), strict=True)
    self._edges, self._axes = torch.stack(edges).to(**like), torch.stack(axes).to(**like)
    # The size of a mesh is not relative to the frame of its geom.
    boxes = torch.as_tensor(model.geom_aabb[ids].copy(), **like)
    is_mesh = torch.as_tensor(model.geom_type[ids] == _G.mjGEOM_MESH, device=env.device)[:, None]
    self._mesh = (boxes[:, :3].abs() + boxes[:, 3:]) * is_mesh
    self._is_there = entity.geom_is_there if isinstance(entity, VariantEntity) else None
    if self._is_there is not None and not bool(self._is_there.any(1).all()):
      raise MjlabError(f"entity '{entity.name}' has no geom in some worlds, so it cannot be lifted there")

  def box(self) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the least and the greatest coordinates in the frame of the body, each (num_envs or 1, 3) [m]."""
    model = self._sim.model
    rotation = matrix_from_quat(model.geom_quat[:, self._geoms])
    position = model.geom_pos[:, self._geoms]
    reach = self._reach(rotation)
    low, high = self._of_those_there(position - reach, torch.inf), self._of_those_there(position + reach, -torch.inf)
    return low.amin(1), high.amax(1)

  def lowest(self) -> torch.Tensor:
    """Return the height of the lowest point, world frame, (num_envs,) [m]."""
    data = self._sim.data
    up = data.geom_xmat[:, self._geoms][..., 2:, :]
    height = data.geom_xpos[:, self._geoms, 2]
    return self._of_those_there(height - self._reach(up)[..., 0], torch.inf).amin(1)

  def _reach(self, directions: torch.Tensor) -> torch.Tensor:
    """Return the reach of geoms along directions in their frames, (..., num_geoms, n, 3) to (..., n)."""
    size = self._sim.model.geom_size[:, self._geoms, :, None]
    edges, axes = (self._edges * size).sum(-2) + self._mesh, (self._axes * size).sum(-2)
    box = (directions.abs() * edges[..., None, :]).sum(-1)
    return box + torch.linalg.vector_norm(directions * axes[..., None, :], dim=-1)

  def _of_those_there(self, values: torch.Tensor, otherwise: float) -> torch.Tensor:
    if self._is_there is None:
      return values
    is_there = self._is_there if values.dim() == 2 else self._is_there[..., None]
    return torch.where(is_there, values, otherwise)
