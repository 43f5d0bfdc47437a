"""Sizes of MuJoCo Warp's buffers for contacts and constraint rows: where they start, and how they grow."""

import dataclasses
from collections.abc import Mapping

import mujoco
import mujoco_warp as mjw
import warp as wp

_Geom = mujoco.mjtGeom
_POINTS = {
  _Geom.mjGEOM_SPHERE: 1,
  _Geom.mjGEOM_ELLIPSOID: 1,
  _Geom.mjGEOM_CAPSULE: 2,
  _Geom.mjGEOM_CYLINDER: 4,
  _Geom.mjGEOM_BOX: 4,
  _Geom.mjGEOM_MESH: 4,
  _Geom.mjGEOM_SDF: 8,
}
"""Contacts of a geom that lies on a plane."""
_LYING = 2 / 3
"""Share of the moving geoms that touch flat ground at a time; robots that fell over have up to half."""
_OBSERVED = 1.5
"""Room as a multiple of the demand of initial states, and of a demand that makes buffers grow."""
FULL = 0.8
"""Share of a buffer above which it grows: demand is seen some steps late."""


def starting_sizes(model: mujoco.MjModel) -> dict[str, int]:
  """Return `nconmax` and `njmax` for a model: from its moving geoms, limits, friction losses and initial states."""
  collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
  moves = model.body_weldid[model.geom_bodyid] != 0
  points = sum(_POINTS.get(_Geom(kind), 0) for kind in model.geom_type[collides & moves]) + model.nflexvert
  # One plane is flat. Anything else is touched from more than one side.
  ground = model.geom_type[collides & ~moves]
  contacts = points * (_LYING if len(ground) <= 1 and (ground == _Geom.mjGEOM_PLANE).all() else 1.0)
  condim = int(max([*model.geom_condim[collides & moves], *model.pair_dim, *model.flex_condim, 1]))
  rows_each = 2 * (condim - 1) if model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL and condim > 1 else condim
  rows = contacts * rows_each + model.jnt_limited.sum() + model.tendon_limited.sum()
  data = mujoco.MjData(model)
  most_rows, fixed_rows = 0, 0
  for key in range(-1, model.nkey):
    mujoco.mj_resetData(model, data) if key < 0 else mujoco.mj_resetDataKeyframe(model, data, key)
    mujoco.mj_forward(model, data)
    contacts, most_rows = max(contacts, _OBSERVED * data.ncon), max(most_rows, data.nefc)
    fixed_rows = max(fixed_rows, data.ne + data.nf)
  return {"nconmax": size_for(contacts), "njmax": size_for(max(rows + fixed_rows, _OBSERVED * most_rows))}


def size_for(count: float) -> int:
  """Return the smallest of 8, 12, 16, 24, 32, 48, ... that holds a count: few sizes, so that few kernels compile."""
  size = 8
  while size < count:
    size = size * 3 // 2 if size & (size - 1) == 0 else size * 4 // 3
  return size


def grown(size: int, demand: int) -> int:
  """Return the size that a demand asks for: the present one, unless it is nearly full."""
  return max(size, size_for(_OBSERVED * demand)) if demand > FULL * size else size


def resize(model: mujoco.MjModel, d: mjw.Data, sizes: Mapping[str, int]) -> None:
  """Give data buffers of other sizes, empty, in new memory. All other arrays stay where they are."""
  with wp.ScopedDevice(d.qpos.device):
    fresh = mjw.make_data(model, nworld=d.nworld, **sizes)
  for owner, larger in ((d, fresh), (d.contact, fresh.contact), (d.efc, fresh.efc)):
    for field in dataclasses.fields(owner):
      now, new = getattr(owner, field.name), getattr(larger, field.name)
      if isinstance(now, int) or (isinstance(now, wp.array) and now.shape != new.shape):
        setattr(owner, field.name, new)
