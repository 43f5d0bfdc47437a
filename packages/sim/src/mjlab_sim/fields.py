"""Names of the state fields, and the model fields that must be expanded together."""

from typing import Any

import mujoco
import numpy as np
from mjlab_core import check_name
from mjlab_core.mujoco.model_fields import FOLLOWERS, PER_WORLD, ROUTE_FOLLOWERS

KINEMATIC_STATE = ("qpos", "qvel", "mocap_pos", "mocap_quat", "eq_active", "plastic")
"""State fields from which position- and velocity-derived quantities follow, constraints and passive forces included."""

STATE = (
  *KINEMATIC_STATE,
  "act",
  "ctrl",
  "qacc_warmstart",
  "qfrc_applied",
  "xfrc_applied",
  "time",
  "userdata",
  "history",
)
"""Fields that a step reads and that any code may write; all others are outputs of the engine."""

_REFERENCE = ("tendon_length0", "eq_data", "cam_pos0", "cam_poscom0", "cam_mat0")
CONSTANTS: dict[str, frozenset[str]] = {
  "FIXED": frozenset(("body_subtreemass", "geom_aabb", "geom_rbound")),
  "KIN0": frozenset((*_REFERENCE, "light_pos0", "light_poscom0", "light_dir0")),
  "INERT0": frozenset(("body_invweight0", "dof_invweight0", "tendon_invweight0", "actuator_acc0")),
}
"""Derived fields by the part of MuJoCo Warp's `set_const` that computes them."""


def closure(names: list[str], model: mujoco.MjModel) -> list[str]:
  """Return `names` and every field derived from them, in a stable order without repetition.

  Raises:
    UnknownNameError: a name that no engine can hold per world.
  """
  for name in names:
    check_name("per-world model field", name, sorted(PER_WORLD))
  tables = (FOLLOWERS, ROUTE_FOLLOWERS) if _has_routes(model) else (FOLLOWERS,)
  derived = (name for source in names for table in tables for name in table.get(source, ()))
  return list(dict.fromkeys([*names, *(name for name in derived if name in PER_WORLD)]))


def _has_routes(model: mujoco.MjModel) -> bool:
  acts_at_sites = np.isin(model.actuator_trntype, (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_SLIDERCRANK))
  return bool(acts_at_sites.any() or (model.wrap_type != mujoco.mjtWrap.mjWRAP_JOINT).any())


def owner_of(model: Any, name: str) -> tuple[Any, str]:
  """Return the object that has a field of a model as an attribute, and the attribute: `opt.<name>` is an option."""
  return (model.opt, name.removeprefix("opt.")) if name.startswith("opt.") else (model, name)


def put(owner: Any, name: str, value: np.ndarray) -> None:
  """Write one world's value of a field of an `MjData`, `MjModel` or `MjOption`, in any shape of the same size."""
  target = getattr(owner, name)
  if np.ndim(target):
    target[:] = value.reshape(np.shape(target))
  else:
    setattr(owner, name, float(value))
