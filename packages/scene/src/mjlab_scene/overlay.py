"""Overlay file: values of a robot that were identified, which take the place of those in its model and actuators.

A JSON object with the keys `model` (values by field of MjModel, then by element), `actuators` (values of `stiffness`,
`damping` and `effort_limit` by joint), `delay` [s] and `encoder_bias` [rad or m] by joint, and `timestep` [s], in whose
steps delays act. Others are ignored.
`Identified.save` of mjlab-sysid writes it.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import mujoco
from mjlab_actuators import ActuatorCfg
from mjlab_core.constraints import Finite, Items, check_value
from mjlab_core.errors import FileError, MjlabError
from mjlab_core.files import printable, reading
from mjlab_core.names import check_name, match_values_full

MODEL_FIELDS: dict[str, tuple[str, str, int]] = {
  "dof_armature": ("joint", "armature", 1),
  "dof_frictionloss": ("joint", "frictionloss", 1),
  "dof_damping": ("joint", "damping", 1),
  "jnt_stiffness": ("joint", "stiffness", 1),
  "body_mass": ("body", "mass", 1),
  "body_ipos": ("body", "ipos", 3),
  "body_inertia": ("body", "inertia", 3),
  "body_iquat": ("body", "iquat", 4),
  "geom_friction": ("geom", "friction", 3),
  "geom_solref": ("geom", "solref", 2),
  "geom_solimp": ("geom", "solimp", 5),
}
"""Kind and attribute in MjSpec, and number of values, of each field that an overlay may hold."""

_ACTUATOR_FIELDS = ("stiffness", "damping", "effort_limit")
_MAX_BYTES = 2**24


@dataclass(frozen=True, kw_only=True)
class Overlay:
  """Values by field and element."""

  source: str
  """Name of the file, for messages."""
  model: dict[str, dict[str, list[float]]] = field(default_factory=dict)
  """Values of MjModel fields by element."""
  actuators: dict[str, dict[str, float]] = field(default_factory=dict)
  """Gains and limits by joint."""
  delay: dict[str, float] = field(default_factory=dict)
  """Delay of set-points by joint [s]."""
  encoder_bias: dict[str, float] = field(default_factory=dict)
  """Reading minus truth by joint [rad or m]."""
  timestep: float = 0.0
  """Timestep of the simulation that the values are for [s]; it matters for delays alone."""

  def check_timestep(self, timestep: float) -> None:
    """Check that delays are in steps of a simulation.

    Raises:
      MjlabError: They are not.
    """
    if self.delay and not math.isclose(self.timestep, timestep, rel_tol=1e-6):
      raise MjlabError(f"{self.source}: its delays are for a timestep of {self.timestep:g} s, not {timestep:g} s")

  def edit_model(self, spec: mujoco.MjSpec) -> None:
    """Write the model fields into a spec.

    Raises:
      UnknownNameError: An element does not exist.
    """
    for name, values in self.model.items():
      kind, attribute, _ = MODEL_FIELDS[name]
      for element, numbers in values.items():
        known = [item.name for item in getattr(spec, {"body": "bodies"}.get(kind, f"{kind}s"))]
        found = getattr(spec, kind)(check_name(kind, element, known, self.source))
        if kind == "body":
          found.explicitinertial = True
          found.fullinertia = [math.nan] * 6
          found.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        if attribute in ("damping", "stiffness"):
          getattr(found, attribute)[0] = numbers[0]
        else:
          setattr(found, attribute, numbers if len(numbers) > 1 else numbers[0])

  def edited(self, actuators: Sequence[ActuatorCfg], spec: mujoco.MjSpec) -> tuple[ActuatorCfg, ...]:
    """Return actuator configs with the gains, limits and delays in place.

    Joints of one config keep one delay setting: lags are drawn between the shortest and the longest delay among them.

    Args:
      actuators: The configs.
      spec: The robot, whose joints the configs name.

    Raises:
      MjlabError: No config drives a joint, or it has no such gain.
    """
    if not (self.actuators or self.delay):
      return tuple(actuators)
    joints = [joint.name for joint in spec.joints]
    left = {(name, joint) for name, values in self.actuators.items() for joint in values}
    left |= {("delay", joint) for joint in self.delay}
    out = []
    for given in actuators:
      cfg = copy.copy(given)
      driven = cfg.match(joints) if cfg.transmission_type == "joint" else []
      for name in _ACTUATOR_FIELDS:
        values = {joint: value for joint, value in self.actuators.get(name, {}).items() if joint in driven}
        if values and hasattr(cfg, name):
          setattr(cfg, name, _by_joint(getattr(cfg, name), driven) | values)
          left -= {(name, joint) for joint in values}
      delays = [self.delay[joint] / self.timestep for joint in driven if joint in self.delay]
      if delays:
        lags = math.floor(min(delays) + 0.05), math.ceil(max(delays) - 0.05)
        cfg = dataclasses.replace(cfg, delay_min_lag=lags[0], delay_max_lag=max(lags))
        left -= {("delay", joint) for joint in driven}
      out.append(cfg)
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
    model = {
      name: {element: _numbers(name, values) for element, values in elements.items()}
      for name, elements in content.get("model", {}).items()
    }
    actuators = {name: _scalars(values) for name, values in content.get("actuators", {}).items()}
    for name in actuators:
      check_name("actuator parameter", printable(name, 80), _ACTUATOR_FIELDS)
    delay, bias = (_scalars(content.get(name, {})) for name in ("delay", "encoder_bias"))
    timestep = float(content.get("timestep", 0.0))
    if delay and not (0.0 < timestep < math.inf and all(0.0 <= value < 1e3 * timestep for value in delay.values())):
      raise FileError(f"delays must lie between 0 and 1000 timesteps of {timestep:g} s")
    return Overlay(
      source=f"overlay {printable(path, 300)}",
      model=model,
      actuators=actuators,
      delay=delay,
      encoder_bias=bias,
      timestep=timestep,
    )


def _numbers(name: str, values: Any) -> list[float]:
  *_, count = MODEL_FIELDS[check_name("field", printable(name, 80), MODEL_FIELDS)]
  numbers = [float(value) for value in (values if isinstance(values, list) else [values])]
  check_value(name, numbers, Annotated[tuple[Finite, ...], Items(ge=count, le=count)])
  return numbers


def _scalars(values: Mapping[str, Any]) -> dict[str, float]:
  out = {str(name): float(value) for name, value in values.items()}
  check_value("values", out, dict[str, Finite])
  return out


def _by_joint(values: Any, driven: Sequence[str]) -> dict[str, float]:
  """Return a config's value of each joint; none where there is no limit."""
  if values is None:
    return {}
  return dict(zip(driven, match_values_full(values, driven, what="joint"), strict=True))
