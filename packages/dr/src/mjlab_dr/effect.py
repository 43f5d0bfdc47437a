"""Which elements and axes of a field count in a model: what would change nothing is found before it is trained on."""

from __future__ import annotations

import mujoco
import numpy as np

from mjlab_dr.catalogue import FIELDS, rows

_SIZES = {
  int(mujoco.mjtGeom.mjGEOM_SPHERE): 1,
  int(mujoco.mjtGeom.mjGEOM_CAPSULE): 2,
  int(mujoco.mjtGeom.mjGEOM_CYLINDER): 2,
  int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): 3,
  int(mujoco.mjtGeom.mjGEOM_BOX): 3,
}
_SCALAR_JOINTS = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
_NO_COLOR = (0.5, 0.5, 0.5, 1.0)
_CONTACT = {
  "geom_friction",
  "geom_solref",
  "geom_solimp",
  "geom_solmix",
  "geom_margin",
  "geom_gap",
  "geom_surfacevel",
  "geom_adhesion",
}
_BY_PRIORITY = {"geom_friction", "geom_solref", "geom_solimp", "geom_solmix"}
_CONDIM = {"geom_friction": (3, 4, 6), "pair_friction": (3, 3, 4, 6, 6)}


def why_element_idle(model: mujoco.MjModel, name: str, i: int) -> str:
  """Why changing field `name` of element `i` would change nothing, as the end of a sentence; "" if it counts."""
  field = FIELDS[name]
  reason = _REASONS[field.kind](model, name, i)
  if not reason and not field.from_zero:
    value = np.asarray(getattr(model.opt, name[4:]) if field.kind == "option" else getattr(model, name))
    at = value if field.kind == "option" else value[list(rows(model, field, i))]
    if not at.any():
      return "was compiled as zero, and engines leave out what is off"
  return reason


def why_axis_idle(model: mujoco.MjModel, name: str, i: int, axis: int) -> str:
  """Why changing one axis of an element that counts would change nothing; "" if it counts."""
  if name == "geom_size":
    used = _SIZES[int(model.geom_type[i])]
    if axis >= used:
      return f"has only {used} size{'s' if used > 1 else ''}"
  elif name in _CONDIM:
    condim = _condim(model, i) if name == "geom_friction" else int(model.pair_dim[i])
    needed = _CONDIM[name][axis]
    if condim < needed:
      return f"needs condim {needed}, which none of its contacts has: it is {condim}"
  elif name == "eq_data":
    kind = mujoco.mjtEq(int(model.eq_type[i]))
    if kind == mujoco.mjtEq.mjEQ_CONNECT and axis >= 3:
      return "is a connection of bodies, whose other numbers follow"
    if kind == mujoco.mjtEq.mjEQ_WELD and axis not in (0, 1, 2, 10):
      return "is a weld, whose relative pose follows"
    if kind not in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD) and axis >= 5:
      return "has a polynomial of five numbers"
  elif name == "mat_texid" and model.mat_texid[i, axis] < 0:
    return "was compiled without a texture for it"
  elif name == "actuator_gear" and axis > 0 and int(model.actuator_trntype[i]) in _SCALAR_TRANSMISSIONS:
    joint = int(model.actuator_trnid[i, 0])
    if int(model.actuator_trntype[i]) == int(mujoco.mjtTrn.mjTRN_TENDON) or model.jnt_type[joint] in _SCALAR_JOINTS:
      return "has one gear"
  elif name in _PARAMETERS:
    types, used_by = _PARAMETERS[name]
    used = used_by.get(int(getattr(model, types)[i]), len(FIELDS[name].axes))
    if axis >= used:
      return f"reads {used} of these numbers"
    is_motor = int(model.actuator_dyntype[i]) == int(mujoco.mjtDyn.mjDYN_DCMOTOR)
    if is_motor and (name, axis) in _MOTOR_STATES and not getattr(model, name)[i, axis]:
      return "was compiled without the state that it would have then"
  return ""


_PARAMETERS: dict[str, tuple[str, dict[int, int]]] = {
  "actuator_gainprm": (
    "actuator_gaintype",
    {
      int(mujoco.mjtGain.mjGAIN_FIXED): 1,
      int(mujoco.mjtGain.mjGAIN_AFFINE): 3,
      int(mujoco.mjtGain.mjGAIN_MUSCLE): 9,
    },
  ),
  "actuator_biasprm": (
    "actuator_biastype",
    {
      int(mujoco.mjtBias.mjBIAS_NONE): 0,
      int(mujoco.mjtBias.mjBIAS_AFFINE): 3,
      int(mujoco.mjtBias.mjBIAS_MUSCLE): 9,
    },
  ),
  "actuator_dynprm": (
    "actuator_dyntype",
    {
      int(mujoco.mjtDyn.mjDYN_INTEGRATOR): 0,
      int(mujoco.mjtDyn.mjDYN_FILTER): 1,
      int(mujoco.mjtDyn.mjDYN_FILTEREXACT): 1,
      int(mujoco.mjtDyn.mjDYN_MUSCLE): 3,
    },
  ),
}
"""Of parameters of actuators, the field that says of which type it is, and how many numbers that type reads."""

_MOTOR_STATES = {*(("actuator_dynprm", axis) for axis in (0, 2, 5, 7)), ("actuator_gainprm", 5)}
"""Parameters of which a DC motor has an activation where they are not zero: they lay out memory."""


_SCALAR_TRANSMISSIONS = (
  int(mujoco.mjtTrn.mjTRN_JOINT),
  int(mujoco.mjtTrn.mjTRN_JOINTINPARENT),
  int(mujoco.mjtTrn.mjTRN_TENDON),
)


def _option(model: mujoco.MjModel, name: str, i: int) -> str:
  del i
  if name == "opt.wind" and not (model.opt.density or model.opt.viscosity):
    return "needs a density or a viscosity of the medium"
  return ""


def _body(model: mujoco.MjModel, name: str, i: int) -> str:
  if name in ("body_pos", "body_quat"):
    first = int(model.body_jntadr[i])
    if model.body_mocapid[i] >= 0 or (first >= 0 and model.jnt_type[first] == _FREE):
      return "floats: its pose is state, which resets write"
    return ""
  if model.body_mass[i] == 0.0:
    return "has no mass"
  if model.body_weldid[i] == 0:
    return "never moves"
  return ""


def _joint(model: mujoco.MjModel, name: str, i: int) -> str:
  kind = int(model.jnt_type[i])
  if name in ("qpos0", "qpos_spring", "encoder_bias") and kind not in _SCALAR_JOINTS:
    return "has more than one coordinate"
  if name == "qpos_spring" and not (model.jnt_stiffness[i] or model.jnt_stiffnesspoly[i].any()):
    return "has no spring"
  if name in ("jnt_range", "jnt_margin", "jnt_solref", "jnt_solimp") and not model.jnt_limited[i]:
    return "has no limits"
  if name == "jnt_actfrcrange" and not model.jnt_actfrclimited[i]:
    return "has no limit of actuator force"
  if name == "jnt_axis" and kind not in _SCALAR_JOINTS:
    return "turns about any axis"
  if name == "jnt_pos" and kind == _FREE:
    return "has no anchor"
  if name in ("dof_solref", "dof_solimp") and not model.dof_frictionloss[model.jnt_dofadr[i]]:
    return "has no dry friction"
  return ""


def _geom(model: mujoco.MjModel, name: str, i: int) -> str:
  if name in _CONTACT and not (model.geom_contype[i] or model.geom_conaffinity[i]):
    return "collides with nothing"
  if name == "geom_size" and int(model.geom_type[i]) not in _SIZES:
    return "is no primitive with a size"
  if name in _BY_PRIORITY:
    touched = _touched(model, i)
    if len(touched) and (model.geom_priority[touched] > model.geom_priority[i]).all():
      return "has a lower priority than all that it can touch"
  return ""


def _condim(model: mujoco.MjModel, i: int) -> int:
  """Largest condim of contacts of a geom that would take its friction."""
  touched = _touched(model, i)
  if not len(touched):
    # What it is to touch may be elsewhere.
    return int(model.geom_condim.max())
  # Of two geoms the one with the higher priority decides, and of equals the larger condim.
  equal = touched[model.geom_priority[touched] == model.geom_priority[i]]
  return max(int(model.geom_condim[i]), *model.geom_condim[equal].tolist(), 0)


def _touched(model: mujoco.MjModel, i: int) -> np.ndarray:
  """Geoms of other bodies that one may collide with."""
  fits = (model.geom_contype & model.geom_conaffinity[i]) | (model.geom_contype[i] & model.geom_conaffinity)
  welded = model.body_weldid[model.geom_bodyid]
  return np.flatnonzero((fits != 0) & (welded != welded[i]))


def _camera(model: mujoco.MjModel, name: str, i: int) -> str:
  has_sensor = bool(model.cam_sensorsize[i].any())
  if name == "cam_fovy" and has_sensor:
    return "has a sensor size, from which its field of view follows"
  if name == "cam_intrinsic" and not has_sensor:
    return "has no sensor size"
  return ""


def _light(model: mujoco.MjModel, name: str, i: int) -> str:
  if name in ("light_cutoff", "light_exponent") and model.light_type[i] != int(mujoco.mjtLightType.mjLIGHT_SPOT):
    return "is no spot light"
  return ""


def _material(model: mujoco.MjModel, name: str, i: int) -> str:
  # A geom has the colour of its material only as long as its own is what MuJoCo gives to those without.
  of_geoms = model.geom_rgba[model.geom_matid == i]
  if name == "mat_rgba" and len(of_geoms) and (of_geoms != _NO_COLOR).any(1).all():
    return "belongs to geoms that have a colour of their own, geom_rgba, instead"
  return ""


def _tendon(model: mujoco.MjModel, name: str, i: int) -> str:
  if (
    name in ("tendon_range", "tendon_margin", "tendon_solref_lim", "tendon_solimp_lim") and not model.tendon_limited[i]
  ):
    return "has no limits"
  if name == "tendon_actfrcrange" and not model.tendon_actfrclimited[i]:
    return "has no limit of actuator force"
  if name in ("tendon_solref_fri", "tendon_solimp_fri") and not model.tendon_frictionloss[i]:
    return "has no dry friction"
  if name == "tendon_lengthspring" and not (model.tendon_stiffness[i] or model.tendon_stiffnesspoly[i].any()):
    return "has no spring"
  return ""


def _actuator(model: mujoco.MjModel, name: str, i: int) -> str:
  if name == "actuator_kp" and not _is_servo(model, i):
    return "is no position actuator"
  if name == "actuator_forcerange" and not model.actuator_forcelimited[i]:
    return "has no limit of force"
  if name == "actuator_actrange" and not model.actuator_actlimited[i]:
    return "has no limit of activation"
  if name == "actuator_ctrlrange" and not model.actuator_ctrllimited[model.actuator_ctrladr[i]]:
    return "has no limit of control"
  if name == "actuator_dynprm" and model.actuator_dyntype[i] == int(mujoco.mjtDyn.mjDYN_NONE):
    return "has no dynamics"
  if name == "actuator_lengthrange" and model.actuator_gaintype[i] != int(mujoco.mjtGain.mjGAIN_MUSCLE):
    return "is no muscle"
  if name == "actuator_cranklength" and model.actuator_trntype[i] != int(mujoco.mjtTrn.mjTRN_SLIDERCRANK):
    return "is no slider-crank"
  if name == "actuator_delay" and model.actuator_historyadr[i] < 0:
    return "was compiled without a delay"
  return ""


def _is_servo(model: mujoco.MjModel, i: int) -> bool:
  is_servo = int(model.actuator_gaintype[i]) == int(mujoco.mjtGain.mjGAIN_FIXED)
  is_servo &= int(model.actuator_biastype[i]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
  return is_servo and bool(model.actuator_gainprm[i, 0] == -model.actuator_biasprm[i, 1] != 0.0)


def _always(model: mujoco.MjModel, name: str, i: int) -> str:
  del model, name, i
  return ""


_REASONS = {
  "option": _option,
  "body": _body,
  "joint": _joint,
  "geom": _geom,
  "site": _always,
  "camera": _camera,
  "light": _light,
  "material": _material,
  "tendon": _tendon,
  "pair": _always,
  "equality": _always,
  "actuator": _actuator,
}
