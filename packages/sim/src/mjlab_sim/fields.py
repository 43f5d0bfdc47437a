"""Which fields of MuJoCo's model may differ per world, and which of them are derived from others."""

from typing import Any

import mujoco
import numpy as np
from mjlab_core.names import unknown

from mjlab_sim.errors import SimulationError

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
"""Fields that a step reads and that anybody may write; all others are outputs of the engine."""

_PER_WORLD = """
actuator_acc0 actuator_actrange actuator_armature actuator_biasprm actuator_cranklength actuator_ctrlrange
actuator_damping actuator_dampingpoly actuator_delay actuator_dynprm actuator_forcerange actuator_gainprm actuator_gear
actuator_history actuator_historyadr actuator_lengthrange body_gravcomp body_inertia body_invweight0 body_ipos
body_iquat body_mass body_pos body_quat body_subtreemass cam_fovy cam_intrinsic cam_mat0 cam_pos cam_pos0 cam_poscom0
cam_quat dof_armature dof_damping dof_dampingpoly dof_frictionloss dof_invweight0 dof_solimp dof_solref eq_data
eq_solimp eq_solref geom_aabb geom_adhesion geom_dataid geom_friction geom_gap geom_margin geom_matid geom_pos
geom_quat geom_rbound geom_rgba geom_size geom_solimp geom_solmix geom_solref geom_surfacevel jnt_actfrcrange jnt_axis
jnt_margin jnt_pos jnt_range jnt_solimp jnt_solref jnt_springyield jnt_stiffness jnt_stiffnesspoly light_active
light_ambient light_attenuation light_castshadow light_cutoff light_diffuse light_dir light_dir0 light_exponent
light_pos light_pos0 light_poscom0 light_specular light_type mat_emission mat_rgba mat_shininess mat_specular mat_texid
mat_texrepeat mat_texuniform pair_adhesion pair_friction pair_gap pair_margin pair_solimp pair_solref
pair_solreffriction qpos0 qpos_spring sensor_delay sensor_history sensor_historyadr sensor_interval site_pos site_quat
tendon_actfrcrange tendon_armature tendon_damping tendon_dampingpoly tendon_frictionloss tendon_invweight0
tendon_length0 tendon_lengthspring tendon_margin tendon_range tendon_solimp_fri tendon_solimp_lim tendon_solref_fri
tendon_solref_lim tendon_springyield tendon_stiffness tendon_stiffnesspoly
opt.gravity opt.timestep opt.wind opt.density opt.viscosity opt.magnetic
"""
PER_WORLD = frozenset(_PER_WORLD.split())
"""Model fields that both engines can hold per world; options are named `opt.<name>`."""

_INERTIAL = ("body_subtreemass", "body_invweight0", "dof_invweight0", "tendon_invweight0", "actuator_acc0")
_CAMERA = ("cam_pos0", "cam_poscom0", "cam_mat0")
_LIGHT = ("light_pos0", "light_poscom0", "light_dir0")
_REFERENCE = ("tendon_length0", "eq_data", *_CAMERA, *_LIGHT)
_ROUTE = ("tendon_length0", *_INERTIAL[1:])

DERIVED: dict[str, tuple[str, ...]] = {
  **dict.fromkeys(("body_mass", "body_inertia", "body_ipos", "body_iquat"), (*_INERTIAL, *_CAMERA, *_LIGHT)),
  **dict.fromkeys(("body_pos", "body_quat", "jnt_pos", "jnt_axis", "qpos0"), (*_INERTIAL, *_REFERENCE)),
  **dict.fromkeys(("dof_armature", "tendon_armature", "actuator_armature", "actuator_gear"), _INERTIAL[1:]),
  **dict.fromkeys(("cam_pos", "cam_quat"), _CAMERA),
  **dict.fromkeys(("light_pos", "light_dir"), _LIGHT),
  "eq_data": ("eq_data",),
  "geom_size": ("geom_aabb", "geom_rbound"),
}
"""Fields that MuJoCo's compiler derives (`mj_setConst`), by the field they follow.

A derived field left shared while its source differs per world would hold one world's value for all, so they are
expanded together.
"""

ROUTED: dict[str, tuple[str, ...]] = dict.fromkeys(
  ("geom_pos", "geom_quat", "geom_size", "site_pos", "site_quat", "actuator_cranklength"), _ROUTE
)
"""What else follows where tendons run through sites or around geoms, or actuators act at sites."""

SOURCES = frozenset((*DERIVED, *ROUTED))
"""Fields that others may follow."""

CONSTANTS: dict[str, frozenset[str]] = {
  "FIXED": frozenset(("body_subtreemass", "geom_aabb", "geom_rbound")),
  "KIN0": frozenset(_REFERENCE),
  "INERT0": frozenset(_INERTIAL[1:]),
}
"""Derived fields by the part of MuJoCo Warp's `set_const` that computes them."""


def closure(names: list[str], model: mujoco.MjModel) -> list[str]:
  """`names` and every field derived from them, in a stable order without repetition.

  Raises:
    SimulationError: a name that no engine can hold per world.
  """
  for name in names:
    if name not in PER_WORLD:
      raise SimulationError(unknown("per-world model field", name, sorted(PER_WORLD)))
  tables = (DERIVED, ROUTED) if _has_routes(model) else (DERIVED,)
  derived = (name for source in names for table in tables for name in table.get(source, ()))
  return list(dict.fromkeys([*names, *derived]))


def _has_routes(model: mujoco.MjModel) -> bool:
  kinds = (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_SLIDERCRANK)
  return bool(np.isin(model.actuator_trntype, [int(kind) for kind in kinds]).any()) or bool(
    (model.wrap_type != int(mujoco.mjtWrap.mjWRAP_JOINT)).any()
  )


def put(data: mujoco.MjData, name: str, value: np.ndarray) -> None:
  """Write one world's value of a field of `STATE`, in whatever shape an engine has it."""
  target: Any = getattr(data, name)
  if np.ndim(target):
    target[:] = value.reshape(np.shape(target))
  else:
    setattr(data, name, float(value))
