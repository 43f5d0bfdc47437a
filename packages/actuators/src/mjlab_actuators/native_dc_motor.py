"""MuJoCo's own DC motor, with its electrical side inside the physics."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
from mjlab_core.names import unknown

from mjlab_actuators.actuator import ActuatorGroup
from mjlab_actuators.actuator_cfg import PerTarget
from mjlab_actuators.command import COMMAND_FIELDS, CommandField
from mjlab_actuators.native import NativeActuatorCfg
from mjlab_actuators.transmission import limit_force

_BITS: dict[CommandField, mujoco.mjtCtrlInput] = {
  "position_target": mujoco.mjtCtrlInput.mjINPUT_POS,
  "velocity_target": mujoco.mjtCtrlInput.mjINPUT_VEL,
  "effort_target": mujoco.mjtCtrlInput.mjINPUT_FF,
}


@dataclass(kw_only=True)
class NativeDcMotorActuatorCfg(NativeActuatorCfg):
  """MuJoCo's DC motor: force = K (V - K w) / R, with w the speed of the motor, gear times that of the target.

  With `inputs="voltage"`, V is the effort target in volts. Otherwise a controller inside MuJoCo asks for the force
  kp (q* - l) + kd (q*' - w) + effort*, of which only the set-points in `inputs` are there (the others count as zero),
  and V is the voltage that gives it, clamped to +-voltage_limit. Set-points are on the motor's side of the gear.
  Constants are those of the motor: either K and R, or `nominal`.
  """

  torque_constant: float | None = None
  """K, which is the back-EMF constant too [N m/A = V s/rad]."""
  resistance: float | None = None
  """R [ohm]."""
  nominal: tuple[float, float, float] | None = None
  """Data sheet instead of K and R: voltage [V], stall torque [N m], no-load speed [rad/s]."""
  inputs: Literal["voltage"] | tuple[CommandField, ...] = "voltage"
  """What drives the motor: a voltage, or some of the three set-points through the controller."""
  stiffness: float = 0.0
  """kp of the controller [N m/rad]."""
  damping: float = 0.0
  """kd of the controller [N m s/rad]."""
  voltage_limit: float | None = None
  """Largest voltage [V]; None for no limit."""
  effort_limit: PerTarget | None = None
  """Largest force of the motor, before the gear [N m]; None for no limit."""
  inductance: float = 0.0
  """L [H]; when positive the current lags with L / R and lives in the simulation's `act`."""
  integral_gain: float = 0.0
  """ki of the controller, on the position error [N m/(rad s)]; its integral lives in the simulation's `act`."""
  integral_limit: float = 0.0
  """Largest effort of the integral [N m]; 0 for no limit."""
  slew_rate: float = 0.0
  """Largest change of the input [unit of the input/s]; 0 for no limit."""
  cogging: tuple[float, float, float] | None = None
  """Amplitude a [N m], periods n per turn, and phase f [rad] of the torque a sin(n l + f); not limited by
  `effort_limit`."""
  lugre: tuple[float, float, float, float, float] | None = None
  """Friction after the LuGre model, not limited either: stiffness [N m/rad] and damping [N m s/rad] of the bristles,
  Coulomb and static friction [N m], Stribeck velocity [rad/s]."""
  thermal: tuple[float, float, float, float, float, float] | None = None
  """Winding that warms up: thermal resistance [K/W], heat capacity [J/K] and time constant [s], of which one may be 0
  and follows from the others; coefficient of the resistance [1/K]; temperature that `resistance` was measured at, and
  that of the surroundings."""
  gear: float = 1.0
  """Reduction between motor and target."""

  def validate(self, target_names: Sequence[str]) -> None:
    super().validate(target_names)
    kind = type(self).__name__
    constants = {"torque_constant": self.torque_constant, "resistance": self.resistance}
    if (self.nominal is None) == (self.torque_constant is None) or (self.nominal is None) == (self.resistance is None):
      raise ValueError(f"{kind}: give torque_constant and resistance, or nominal")
    names = ("voltage", "stall torque", "no-load speed")
    constants |= {f"nominal {name}": value for name, value in zip(names, self.nominal or (), strict=False)}
    constants["voltage_limit"] = self.voltage_limit
    for name, value in constants.items():
      if value is not None and not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{kind}: {name} is {value}; it must be finite and positive")
    for name in ("stiffness", "damping", "inductance", "integral_gain", "integral_limit", "slew_rate"):
      if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
        raise ValueError(f"{kind}: {name} is {getattr(self, name)}; it must be finite and not negative")
    for name in ("cogging", "lugre", "thermal"):
      numbers = getattr(self, name)
      if numbers is not None and not all(math.isfinite(number) for number in numbers):
        raise ValueError(f"{kind}: {name} is {numbers}; it must be finite")
    self._check_gear(self.gear)
    self._limits("effort_limit", target_names)
    self._validate_inputs(kind)

  def _reads_position(self) -> bool:
    return self.stiffness > 0.0

  def _validate_inputs(self, kind: str) -> None:
    if self.inputs == "voltage":
      if self.stiffness or self.damping or self.integral_gain:
        raise ValueError(f"{kind}: stiffness, damping and integral_gain are a controller's; inputs 'voltage' has none")
      return
    for name in self.inputs:
      if name not in COMMAND_FIELDS:
        raise ValueError(unknown("input", name, COMMAND_FIELDS, owner=kind))
    if not self.inputs or len(set(self.inputs)) != len(self.inputs):
      raise ValueError(f"{kind}: inputs is {self.inputs!r}; name at least one set-point, each once")
    if self.integral_gain > 0.0 and "position_target" not in self.inputs:
      raise ValueError(f"{kind}: integral_gain is given, but inputs has no position_target to integrate the error of")
    if "position_target" in self.inputs and self.stiffness == 0.0:
      raise ValueError(f"{kind}: stiffness is 0, so that a position target would do nothing")
    if "velocity_target" in self.inputs and self.damping == 0.0:
      raise ValueError(f"{kind}: damping is 0, so that a velocity target would do nothing")

  @property
  def _fields(self) -> tuple[CommandField, ...]:
    """The set-points that are handed over, in the order of MuJoCo's inputs."""
    if self.inputs == "voltage":
      return ("effort_target",)
    return tuple(field for field in COMMAND_FIELDS if field in self.inputs)

  def groups(self, model: mujoco.MjModel, target_names: Sequence[str], prefix: str = "") -> list[ActuatorGroup]:
    """One group per set-point: a motor with several has as many neighbouring inputs in ctrl."""
    (first,) = super().groups(model, target_names, prefix)
    return [
      replace(first, command_fields=(field,), ctrl_ids=tuple(index + offset for index in first.ctrl_ids))
      for offset, field in enumerate(self._fields)
    ]

  def _group(self, target_names: Sequence[str], ctrl_ids: Sequence[int]) -> ActuatorGroup:
    if not ctrl_ids and len(self._fields) > 1:
      raise ValueError(f"{type(self).__name__}: without a model, a motor of one input can be built, not of several")
    return replace(super()._group(target_names, ctrl_ids), command_fields=self._fields[:1])

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    volts = self.voltage_limit or 0.0
    controlled = self.inputs != "voltage"
    bits = [_BITS[field] for field in self._fields] if controlled else [mujoco.mjtCtrlInput.mjINPUT_VOLTAGE]
    constant = self.torque_constant or 0.0
    elements = self._bare_elements(spec, target_names, self.gear)
    for element, limit in zip(elements, self._limits("effort_limit", target_names), strict=True):
      element.set_to_dcmotor(
        motorconst=[constant, constant],
        resistance=self.resistance or 0.0,
        nominal=list(self.nominal or (0.0, 0.0, 0.0)),
        inductance=[self.inductance, 0.0],
        cogging=list(self.cogging or (0.0,) * 3),
        controller=[
          self.stiffness,
          self.integral_gain,
          self.damping,
          self.slew_rate,
          self.integral_limit,
          volts if controlled else 0.0,
        ],
        thermal=list(self.thermal or (0.0,) * 6),
        lugre=list(self.lugre or (0.0,) * 5),
        ctrlspec=sum(int(bit) for bit in bits),
      )
      limit_force(element, limit)
      if volts and not controlled:
        element.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
        element.ctrlrange = [-volts, volts]
