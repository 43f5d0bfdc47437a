"""Table of the MuJoCo model fields that may differ per world, and of the fields that follow from each.

Options are named `opt.<name>`. `mj_setConst` derives the followers from a field. A follower that stayed shared while
its source differs per world would hold one world's value for all.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
  import torch

_INVERSE = ("body_invweight0", "dof_invweight0", "dof_M0", "tendon_invweight0", "actuator_acc0")
_LENGTH = ("tendon_length0", "actuator_length0")
_CAMERA = ("cam_pos0", "cam_poscom0", "cam_mat0")
_LIGHT = ("light_pos0", "light_poscom0", "light_dir0")
_CENTRE = (*_INVERSE, "cam_poscom0", "light_poscom0")
_KINEMATICS = (*_INVERSE, *_LENGTH, "eq_data", *_CAMERA, *_LIGHT)

FOLLOWERS: dict[str, tuple[str, ...]] = {
  "body_mass": ("body_subtreemass", *_CENTRE),
  "body_inertia": _INVERSE,
  "body_ipos": _CENTRE,
  "body_iquat": _INVERSE,
  **dict.fromkeys(("body_pos", "body_quat", "qpos0"), _KINEMATICS),
  **dict.fromkeys(("jnt_pos", "jnt_axis", "dof_armature", "tendon_armature", "actuator_armature"), _INVERSE),
  **dict.fromkeys(("actuator_gear", "actuator_cranklength"), (*_INVERSE, "actuator_length0")),
  **dict.fromkeys(("cam_pos", "cam_quat"), _CAMERA),
  **dict.fromkeys(("light_pos", "light_dir"), _LIGHT),
  # Values from the author of the model are kept, and the others follow.
  "eq_data": ("eq_data",),
  "geom_size": ("geom_aabb", "geom_rbound"),
}
"""Fields that follow from a field, whatever else the model has; fields without followers are left out."""

ROUTE_FOLLOWERS: dict[str, tuple[str, ...]] = dict.fromkeys(
  ("geom_pos", "geom_quat", "geom_size", "site_pos", "site_quat"), (*_LENGTH, *_INVERSE)
)
"""Further fields that follow if tendons run through sites or around geoms, or actuators act at sites."""

FLAGGED = frozenset(
  """
  body_gravcomp qpos_spring geom_pos geom_quat geom_margin geom_gap geom_surfacevel geom_adhesion site_pos site_quat
  pair_adhesion tendon_stiffness tendon_stiffnesspoly tendon_damping tendon_dampingpoly actuator_damping
  actuator_dampingpoly
  """.split()
)
"""Fields that `mj_setConst` reads for internal flags and bounds, so that it must run after they change."""

SOURCES = frozenset((*FOLLOWERS, *ROUTE_FOLLOWERS, *FLAGGED))
"""Fields that require `mj_setConst` after a change."""

PER_WORLD = frozenset(
  """
  actuator_acc0 actuator_actrange actuator_armature actuator_biasprm actuator_cranklength actuator_ctrlrange
  actuator_damping actuator_dampingpoly actuator_delay actuator_dynprm actuator_forcerange actuator_gainprm
  actuator_gear actuator_history actuator_historyadr actuator_lengthrange
  body_gravcomp body_inertia body_invweight0 body_ipos body_iquat body_mass body_pos body_quat body_subtreemass
  cam_fovy cam_intrinsic cam_mat0 cam_pos cam_pos0 cam_poscom0 cam_quat
  dof_armature dof_damping dof_dampingpoly dof_frictionloss dof_invweight0 dof_solimp dof_solref
  eq_data eq_solimp eq_solref
  geom_aabb geom_adhesion geom_dataid geom_friction geom_gap geom_margin geom_matid geom_pos geom_quat geom_rbound
  geom_rgba geom_size geom_solimp geom_solmix geom_solref geom_surfacevel
  jnt_actfrcrange jnt_axis jnt_margin jnt_pos jnt_range jnt_solimp jnt_solref jnt_springyield jnt_stiffness
  jnt_stiffnesspoly
  light_active light_ambient light_attenuation light_castshadow light_cutoff light_diffuse light_dir light_dir0
  light_exponent light_pos light_pos0 light_poscom0 light_specular light_type
  mat_emission mat_rgba mat_shininess mat_specular mat_texid mat_texrepeat mat_texuniform
  pair_adhesion pair_friction pair_gap pair_margin pair_solimp pair_solref pair_solreffriction
  qpos0 qpos_spring
  sensor_delay sensor_history sensor_historyadr sensor_interval
  site_pos site_quat
  tendon_actfrcrange tendon_armature tendon_damping tendon_dampingpoly tendon_frictionloss tendon_invweight0
  tendon_length0 tendon_lengthspring tendon_margin tendon_range tendon_solimp_fri tendon_solimp_lim tendon_solref_fri
  tendon_solref_lim tendon_springyield tendon_stiffness tendon_stiffnesspoly
  opt.gravity opt.timestep opt.wind opt.density opt.viscosity opt.magnetic
  """.split()
)
"""Model fields that both engines of mjlab-sim can hold per world."""


class ModelFields(Protocol):
  """Model fields of a simulation of `num_envs` worlds."""

  @property
  def num_envs(self) -> int:
    """Number of worlds."""
    ...

  @property
  def device(self) -> torch.device:
    """Device of the fields."""
    ...

  @property
  def mj_model(self) -> Any:
    """The compiled `mujoco.MjModel`; never written."""
    ...

  @property
  def model(self) -> Any:
    """Fields of MjModel as attributes: tensors (num_envs, ...) once expanded, in fixed memory; options `opt.<name>`."""
    ...

  def expand_model_fields(self, names: Iterable[str], /) -> None:
    """Give these fields, and those that derive from them, one value per world."""
    ...

  def default_field(self, name: str, /) -> torch.Tensor:
    """Return the compiled value, (1, ...), or one for each world, (num_envs, ...), in fixed memory."""
    ...

  def recompute_constants(self, mask: torch.Tensor | None = None, /) -> None:
    """Recompute the derived fields of the masked worlds, bool (num_envs,)."""
    ...


_COUNTS = {"joint": "njnt", "camera": "ncam", "material": "nmat", "texture": "ntex", "equality": "neq"}


def element_names(model: Any, kind: str) -> list[str]:
  """Return the names of all elements of a kind, such as "body" or "joint", in an `MjModel`, in its order."""
  element = getattr(model, kind)
  return [element(i).name for i in range(getattr(model, _COUNTS.get(kind, f"n{kind}")))]


def followers(name: str) -> tuple[str, ...]:
  """Return the fields that `mj_setConst` may derive from the field `name`, in a stable order."""
  return tuple(dict.fromkeys((*FOLLOWERS.get(name, ()), *ROUTE_FOLLOWERS.get(name, ()))))
