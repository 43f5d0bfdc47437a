"""Overlay file: identified values of a robot, which replace those of its model and actuators.

A JSON object with the keys `model` (values by field of MjModel, then by element; that of options is "option"),
`actuators` (values of `stiffness`, `damping` and `effort_limit` by joint), `delay` [s] and `encoder_bias` [rad or m] by
joint, and `timestep` [s], the step of delays. Other keys are ignored.
`Identified.save` of mjlab-sysid writes it.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import mujoco
import numpy as np
from mjlab_actuators import ActuatorCfg
from mjlab_core import (
  FileError,
  Finite,
  Items,
  MjlabError,
  NonNegative,
  check_fields,
  check_name,
  check_value,
  match_values_full,
  printable,
  reading,
)

_ATTRIBUTES = {
  "opt": "gravity wind density viscosity magnetic",
  "body": "mass inertia ipos iquat pos quat gravcomp",
  "jnt": "pos axis range margin solref=solref_limit solimp=solimp_limit stiffness stiffnesspoly springyield "
  "actfrcrange",
  "dof": "damping dampingpoly armature frictionloss solref=solref_friction solimp=solimp_friction",
  "geom": "friction size pos quat solref solimp solmix margin gap surfacevel adhesion",
  "site": "pos quat",
  "pair": "friction solref solreffriction solimp margin gap adhesion",
  "eq": "data solref solimp",
  "tendon": "range margin solref_lim=solref_limit solimp_lim=solimp_limit solref_fri=solref_friction "
  "solimp_fri=solimp_friction actfrcrange stiffness stiffnesspoly damping dampingpoly armature frictionloss "
  "lengthspring=springlength springyield",
  "actuator": "gainprm biasprm dynprm forcerange ctrlrange actrange lengthrange gear cranklength armature damping "
  "dampingpoly delay",
}
_KINDS = {"opt": "option", "jnt": "joint", "dof": "joint", "eq": "equality"}
_PLURAL = {"body": "bodies", "equality": "equalities"}

MODEL_FIELDS: dict[str, tuple[str, str]] = {
  f"{prefix}{'.' if prefix == 'opt' else '_'}{words.partition('=')[0]}": (
    _KINDS.get(prefix, prefix),
    words.partition("=")[2] or words,
  )
  for prefix, attributes in _ATTRIBUTES.items()
  for words in attributes.split()
} | {"qpos0": ("joint", "ref"), "qpos_spring": ("joint", "springref")}
"""Kind of element and attribute in MjSpec of each field that an overlay may hold."""

_KEYS = ("model", "actuators", "delay", "encoder_bias", "timestep")
_ACTUATOR_FIELDS = ("stiffness", "damping", "effort_limit")
_MAX_BYTES = 2**24


@dataclass(frozen=True, kw_only=True)
class Overlay:
  """Values by field and element."""

  source: str
  """Name of the file, for messages."""
  model: Mapping[str, Mapping[str, Finite | tuple[Finite, ...]]] = field(default_factory=dict)
  """Values of MjModel fields by element."""
  actuators: Mapping[str, Mapping[str, Finite]] = field(default_factory=dict)
  """Gains and limits by joint."""
  delay: Mapping[str, NonNegative] = field(default_factory=dict)
  """Delay of targets by joint [s]."""
  encoder_bias: Mapping[str, Finite] = field(default_factory=dict)
  """Reading minus truth by joint [rad or m]."""
  timestep: NonNegative = 0.0
  """Timestep of the simulation that the values are for [s]; only delays need it."""

  def check_timestep(self, timestep: float) -> None:
    """Raise MjlabError unless delays are in steps of `timestep` [s]."""
    if self.delay and not math.isclose(self.timestep, timestep, rel_tol=1e-6):
      raise MjlabError(f"{self.source}: its delays are for a timestep of {self.timestep:g} s, not {timestep:g} s")

  def edit_model(self, spec: mujoco.MjSpec) -> None:
    """Write the model fields into a spec.

    Raises:
      UnknownNameError: An element does not exist.
      MjlabError: A field has another number of values, or the compiled model would not have these values.
    """
    if not self.model:
      return
    given = [
      (name, element, np.atleast_1d(values).astype(float).tolist())
      for name, of in self.model.items()
      for element, values in of.items()
    ]
    before = spec.copy().compile()
    for name, element, numbers in given:
      kind, attribute = MODEL_FIELDS[name]
      known = ["option"] if kind == "option" else [item.name for item in getattr(spec, _PLURAL.get(kind, f"{kind}s"))]
      check_name(kind, element, known, self.source)
      count = compiled_values(before, name, element).size
      check_value(f"{self.source}: {name}", numbers, Annotated[list[float], Items(ge=count, le=count)])
      _set(spec.option if kind == "option" else getattr(spec, kind)(element), kind, attribute, numbers, before)
    self._check_compiled(spec.copy().compile(), given)

  def _check_compiled(self, model: mujoco.MjModel, given: Sequence[tuple[str, str, list[float]]]) -> None:
    for name, element, numbers in given:
      has = compiled_values(model, name, element)
      sign = np.sign(has @ numbers) if name.endswith("quat") else 1.0
      if not np.allclose(sign * has, numbers, rtol=1e-6, atol=1e-9):
        raise MjlabError(
          f"{self.source}: {name} of '{element}' cannot be {numbers}: a frame, a mesh or another attribute of the "
          f"model makes it {has.tolist()}"
        )

  def edited(self, actuators: Sequence[ActuatorCfg], spec: mujoco.MjSpec) -> tuple[ActuatorCfg, ...]:
    """Return actuator configs with the gains, limits and delays in place.

    Joints of one config keep one delay setting: lags are drawn between the shortest and the longest delay among them.

    Args:
      actuators: The configs.
      spec: The robot.

    Raises:
      MjlabError: No config drives a joint, or it has no such gain.
    """
    if not (self.actuators or self.delay):
      return tuple(actuators)
    joints = [joint.name for joint in spec.joints]
    left = {(name, joint) for name, values in self.actuators.items() for joint in values}
    left |= {("delay", joint) for joint in self.delay}
    out = []
    for cfg in actuators:
      driven = cfg.match(joints) if cfg.transmission_type == "joint" else []
      changes: dict[str, Any] = {}
      for name in _ACTUATOR_FIELDS:
        values = {joint: value for joint, value in self.actuators.get(name, {}).items() if joint in driven}
        if values and hasattr(cfg, name):
          present = match_values_full(getattr(cfg, name), driven, what="joint")
          limits = [math.inf if value is None else value for value in present]
          changes[name] = dict(zip(driven, limits, strict=True)) | values
          left -= {(name, joint) for joint in values}
      delays = [self.delay[joint] / self.timestep for joint in driven if joint in self.delay]
      if delays:
        shortest, longest = math.floor(min(delays) + 0.05), math.ceil(max(delays) - 0.05)
        changes |= {"delay_min_lag": shortest, "delay_max_lag": max(shortest, longest)}
        left -= {("delay", joint) for joint in driven}
      out.append(dataclasses.replace(cfg, **changes))
    if left:
      name, joint = sorted(left)[0]
      raise MjlabError(f"{self.source}: no actuator config has the {name} of '{joint}'")
    return tuple(out)


def read_overlay(path: str | Path) -> Overlay:
  """Return the overlay in a file.

  Raises:
    FileError: The file is missing or damaged, or holds a field that an overlay cannot hold.
  """
  with reading("overlay", path, _MAX_BYTES):
    content = json.loads(Path(path).read_text(encoding="utf-8"))
    if not isinstance(content, dict) or content.get("format") != "mjlab overlay 1":
      raise FileError("expected an object with format 'mjlab overlay 1'")
    given = {name: content[name] for name in _KEYS if name in content}
    overlay = Overlay(source=f"overlay {printable(path, 300)}", **given)
    check_fields(overlay, "overlay")
    for what, table, known in (
      ("field", overlay.model, MODEL_FIELDS),
      ("actuator parameter", overlay.actuators, _ACTUATOR_FIELDS),
    ):
      for name in table:
        check_name(what, printable(name, 80), known)
    if any(value >= 1e3 * overlay.timestep for value in overlay.delay.values()):
      raise FileError(f"delays must lie between 0 and 1000 timesteps of {overlay.timestep:g} s")
    return overlay


def compiled_values(model: Any, name: str, element: str) -> np.ndarray:
  """Return the values of an element, of the first degree of freedom of a joint, in a field of a compiled model."""
  if name.startswith("opt."):
    return np.atleast_1d(getattr(model.opt, name[4:])).astype(float)
  kind, _ = MODEL_FIELDS[name]
  item = getattr(model, kind)(element)
  index = item.dofadr[0] if name.startswith("dof_") else item.qposadr[0] if name.startswith("qpos") else item.id
  return np.atleast_1d(getattr(model, name)[index]).astype(float)


def _set(found: Any, kind: str, attribute: str, numbers: list[float], before: Any) -> None:
  """Write compiled values into an element of a spec so that its other attributes do not override them."""
  has: Any = getattr(before, kind)(found.name) if kind != "option" else None
  if kind == "body" and attribute in ("mass", "inertia", "ipos", "iquat"):
    if not found.explicitinertial:
      found.mass, found.inertia, found.ipos, found.iquat = has.mass[0], has.inertia, has.ipos, has.iquat
    found.explicitinertial = True
    found.fullinertia = [math.nan] * 6
    found.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
  elif kind in ("geom", "site") and math.isfinite(found.fromto[0]):
    found.pos, found.quat, found.size = has.pos, has.quat, has.size
    found.fromto = [math.nan] * 6
  if attribute == "quat":
    found.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
  is_angle = (
    kind == "joint" and attribute in ("range", "ref", "springref") and found.type != mujoco.mjtJoint.mjJNT_SLIDE
  )
  if is_angle and found.compiler.degree:
    numbers = [math.degrees(value) for value in numbers]
  if attribute == "data" and found.type == mujoco.mjtEq.mjEQ_WELD and not any(found.data[6:10]):
    # The compiler derives the pose of a weld without one, and notes this in the last number.
    numbers = [*numbers[:3], *found.data[3:10], *numbers[10:11], *found.data[11:]]
  if attribute.endswith("poly"):
    getattr(found, attribute.removesuffix("poly"))[1:] = numbers
  elif attribute in ("damping", "stiffness"):
    getattr(found, attribute)[0] = numbers[0]
  else:
    setattr(found, attribute, numbers if np.ndim(getattr(found, attribute)) else numbers[0])
