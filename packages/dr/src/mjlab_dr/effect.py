"""Elements and numbers of a model in which a change has no effect, found by MuJoCo itself where possible."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from itertools import product
from operator import attrgetter

import mujoco
import numpy as np

from mjlab_dr.catalogue import FIELDS, needs_constants
from mjlab_dr.fields import element_names, rows

_NO_COLOR = (0.5, 0.5, 0.5, 1.0)
_CONDIM = {"geom_friction": (3, 4, 6), "pair_friction": (3, 3, 4, 6, 6)}
_BY_PRIORITY = {"geom_friction", "geom_solref", "geom_solimp", "geom_solmix"}
_CONTACT = _BY_PRIORITY | {"geom_margin", "geom_gap", "geom_surfacevel", "geom_adhesion"}
_MOTOR_STATES = {*(("actuator_dynprm", axis) for axis in (0, 2, 5, 7)), ("actuator_gainprm", 5)}
"""Parameters of which a DC motor has an activation if they are not zero: a change would move memory."""

_INERTIAL = {"body_mass", "body_inertia", "body_ipos", "body_iquat", "pseudo_inertia"}
_PROBED = {"body", "joint", "tendon", "actuator", "equality"}
# Plastic springs yield over time; `_element_reason` has the reasons of the others.
_UNPROBED = _INERTIAL | {"jnt_springyield", "tendon_springyield", "actuator_delay", "actuator_kp"}
_PROBED_AXES = {"geom_size", "eq_data", "actuator_gear", "actuator_gainprm", "actuator_biasprm", "actuator_dynprm"}
_USUAL = {
  **dict.fromkeys(("jnt_range", "jnt_margin", "jnt_solref", "jnt_solimp"), "has no limits"),
  **dict.fromkeys(("tendon_range", "tendon_margin", "tendon_solref_lim", "tendon_solimp_lim"), "has no limits"),
  **dict.fromkeys(("jnt_actfrcrange", "tendon_actfrcrange"), "has no limit of actuator force, or no actuator"),
  **dict.fromkeys(("dof_solref", "dof_solimp", "tendon_solref_fri", "tendon_solimp_fri"), "has no dry friction"),
  **dict.fromkeys(("qpos_spring", "tendon_lengthspring"), "has no spring"),
  **dict.fromkeys(("body_pos", "body_quat"), "floats: its pose is state, which resets write"),
  "jnt_axis": "turns about any axis",
  "jnt_pos": "has no anchor",
  "geom_size": "is no primitive with that size",
  "actuator_forcerange": "has no limit of force",
  "actuator_actrange": "has no limit of activation",
  "actuator_ctrlrange": "has no limit of control",
  "actuator_dynprm": "has no dynamics that read it",
  "actuator_lengthrange": "is no muscle",
  "actuator_cranklength": "is no slider-crank",
  "actuator_gear": "has one gear",
  "eq_data": "follows from its other numbers",
}
"""Usual reason why MuJoCo does not read a field, to follow "it"."""


SIMPLE = (
  "compiled as simple: MuJoCo keeps its inertia matrix diagonal, whatever this field says. Scenes of mjlab compile no "
  'body as simple; elsewhere set simple="false" on it before compiling (`MjSpec.body(name).simple = False`)'
)
"""Reason of a body with several degrees of freedom that the compiler found to be independent.

Both engines store no more than the diagonal of its part of the inertia matrix. It stays diagonal while the centre of
mass is the origin of the body, the principal axes are its axes, and its degrees of freedom act along these and through
the origin.
"""


def idle(model: mujoco.MjModel, name: str, ids: Sequence[int], axes: Sequence[int]) -> dict[tuple[int, int], str]:
  """Return the numbers of a field, by element and axis, of which a change has no effect; reasons follow "it"."""
  field, found = FIELDS[name], dict[tuple[int, int], str]()
  for i, axis in product(ids, axes):
    if reason := _element_reason(model, name, i) or _axis_reason(model, name, i, axis):
      found[i, axis] = reason
  by_axis = name in _PROBED_AXES
  if by_axis or (field.kind in _PROBED and field.in_model and name not in _UNPROBED):
    probe = _Probe(model, name)
    for i, group in product(ids, [[axis] for axis in axes] if by_axis else [axes]):
      columns = group if by_axis else range(field.width)
      if (i, group[0]) not in found and not probe.reads(list(product(rows(model, field, i), columns))):
        found |= dict.fromkeys(product([i], group), _reason(name))
  return found


def _reason(name: str) -> str:
  return _USUAL.get(name, "is not read by MuJoCo")


def _element_reason(model: mujoco.MjModel, name: str, i: int) -> str:
  """Return why a change of an element has no effect, as far as a step of MuJoCo does not show it; "" if it has."""
  field = FIELDS[name]
  if name in ("body_ipos", "body_iquat") and model.body_simple[i]:
    return f"was {SIMPLE}"
  if name in ("jnt_pos", "jnt_axis"):
    body = int(model.jnt_bodyid[i])
    # The matrix of a single degree of freedom is its diagonal.
    if model.body_simple[body] and model.body_dofnum[body] > 1:
      return f"moves body {element_names(model, 'body')[body]!r}, which was {SIMPLE}"
  if name == "opt.wind" and not (model.opt.density or model.opt.viscosity):
    return "needs a density or a viscosity of the medium"
  if name in ("qpos0", "qpos_spring", "encoder_bias") and model.jnt_type[i] < int(mujoco.mjtJoint.mjJNT_SLIDE):
    return "has more than one coordinate"
  if name in _INERTIAL and not (model.body_mass[i] and model.body_weldid[i]):
    return "never moves" if model.body_mass[i] else "has no mass"
  if name in ("body_pos", "body_quat") and model.body_mocapid[i] >= 0:
    return _reason(name)
  if name == "actuator_kp" and not model.actuator_gainprm[i, 0] == -model.actuator_biasprm[i, 1] != 0.0:
    return "is no position actuator"
  if name == "actuator_delay" and model.actuator_historyadr[i] < 0:
    return "was compiled without a delay"
  if name in ("light_cutoff", "light_exponent") and model.light_type[i] != int(mujoco.mjtLightType.mjLIGHT_SPOT):
    return "is no spot light"
  if field.kind == "camera" and name in ("cam_fovy", "cam_intrinsic"):
    has_sensor = bool(model.cam_sensorsize[i].any())
    if has_sensor != (name == "cam_intrinsic"):
      return "has a sensor size, from which its field of view follows" if has_sensor else "has no sensor size"
  # A geom has the colour of its material only as long as its own is the one of geoms without colour.
  of_geoms = model.geom_rgba[model.geom_matid == i]
  if name == "mat_rgba" and len(of_geoms) and (of_geoms != _NO_COLOR).any(1).all():
    return "belongs to geoms that have a colour of their own, geom_rgba, instead"
  if name in _CONTACT and not (model.geom_contype[i] or model.geom_conaffinity[i]):
    return "collides with nothing"
  touched = _touched(model, i) if name in _BY_PRIORITY else np.empty(0, int)
  if len(touched) and (model.geom_priority[touched] > model.geom_priority[i]).all():
    return "has a lower priority than all that it can touch"
  if not field.from_zero:
    value = np.atleast_1d(attrgetter(name)(model))
    if not (value if field.kind == "option" else value[list(rows(model, field, i))]).any():
      return "was compiled as zero, and engines leave out what is off"
  return ""


def _axis_reason(model: mujoco.MjModel, name: str, i: int, axis: int) -> str:
  """Return why a change of one axis has no effect, as far as a step of MuJoCo does not show it, or is not allowed."""
  if name in _CONDIM:
    condim = _condim(model, i) if name == "geom_friction" else int(model.pair_dim[i])
    if condim < (needed := _CONDIM[name][axis]):
      return f"needs condim {needed}, which none of its contacts has: it is {condim}"
  # Factors and stretches leave the centre of mass and the principal axes as they are.
  if name == "pseudo_inertia" and axis > 3 and model.body_simple[i]:
    return f"was {SIMPLE}"
  if name == "mat_texid" and model.mat_texid[i, axis] < 0:
    return "was compiled without a texture for it"
  if (name, axis) in _MOTOR_STATES and model.actuator_dyntype[i] == int(mujoco.mjtDyn.mjDYN_DCMOTOR):
    return "" if getattr(model, name)[i, axis] else "was compiled without the state that it would have then"
  return ""


def _condim(model: mujoco.MjModel, i: int) -> int:
  """Return the largest condim of contacts of a geom that would take its friction."""
  touched = _touched(model, i)
  if not len(touched):
    # Geoms that it is to touch may be elsewhere.
    return int(model.geom_condim.max())
  # The geom with the higher priority decides; between equals, the larger condim.
  equal = touched[model.geom_priority[touched] == model.geom_priority[i]]
  return max(int(model.geom_condim[i]), *model.geom_condim[equal].tolist(), 0)


def _touched(model: mujoco.MjModel, i: int) -> np.ndarray:
  """Return the geoms of other bodies that one may collide with."""
  fits = (model.geom_contype & model.geom_conaffinity[i]) | (model.geom_contype[i] & model.geom_conaffinity)
  welded = model.body_weldid[model.geom_bodyid]
  return np.flatnonzero((fits != 0) & (welded != welded[i]))


class _Probe:
  """Copy of a model in states in which all that may act does: beyond limits, driven, and with active equalities.

  A number that MuJoCo does not read in any of them has no effect.
  """

  _OUTPUTS = (
    "xpos xquat ten_length efc_J efc_pos efc_margin efc_frictionloss efc_R efc_aref qfrc_bias qfrc_passive "
    "qfrc_actuator actuator_force act_dot qacc_smooth act"
  ).split()

  def __init__(self, model: mujoco.MjModel, name: str) -> None:
    self._name, self._model = name, copy.copy(model)
    self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    self._model.actuator_delay[:] = 0.0
    for margin in ("jnt_margin", "tendon_margin"):
      getattr(self._model, margin)[:] = 0.0 if margin == name else 1e6
    self._data = mujoco.MjData(self._model)
    rng = np.random.default_rng(0)
    self._states: list[tuple[np.ndarray, ...]] = []
    for scale in (0.0, 0.1, 0.3, 1.0, 3.0, 100.0) * 2:
      qpos, qvel, ctrl = (rng.uniform(-1.0, 1.0, size) for size in (model.nq, model.nv, model.nu))
      self._states.append((model.qpos0 + scale * qpos, 9.0 * qvel, 9.0 * ctrl))
    self._derive()
    self._before = [self._outputs(state) for state in self._states]

  def reads(self, places: Sequence[tuple[int, int]]) -> bool:
    """Return True if other values in these rows and columns have an effect; the old ones are put back."""
    field = FIELDS[self._name]
    array = getattr(self._model, self._name).reshape(-1, field.width)
    for value in (None, 1e3, -1e3):
      before = array.copy()
      for row, axis in places:
        lo, hi = field.bounds(axis)
        array[row, axis] = np.clip(2.0 * array[row, axis] + 1.0 if value is None else value, lo, hi)
      changed = self._differs()
      array[:] = before
      self._derive()
      if changed or "timeconst" in field.axes:
        return changed
    return False

  def _differs(self) -> bool:
    try:
      self._derive()
      outputs = map(self._outputs, self._states)
      return not all(np.array_equal(now, before) for now, before in zip(outputs, self._before, strict=True))
    except mujoco.FatalError:
      # MuJoCo objects to a number that it reads.
      return True

  def _derive(self) -> None:
    if needs_constants(self._name):
      mujoco.mj_resetData(self._model, self._data)
      mujoco.mj_setConst(self._model, self._data)

  def _outputs(self, state: tuple[np.ndarray, ...]) -> np.ndarray:
    model, data = self._model, self._data
    mujoco.mj_resetData(model, data)
    data.qpos, data.qvel, data.ctrl = state
    data.act[:], data.eq_active[:], data.mocap_pos[:], data.mocap_quat[:] = 0.5, 1, 0.0, (1.0, 0.0, 0.0, 0.0)
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    mujoco.mj_fwdActuation(model, data)
    mujoco.mj_fwdAcceleration(model, data)
    data.qacc[:] = 0.0
    mujoco.mj_Euler(model, data)
    found = [getattr(data, name) for name in self._OUTPUTS]
    return np.concatenate([values.ravel() for values in (*found, model.geom_rbound, model.geom_aabb)])
