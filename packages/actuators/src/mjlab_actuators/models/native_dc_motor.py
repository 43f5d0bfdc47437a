"""MuJoCo's own DC motor, with its electrical side inside the physics."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import mujoco
from mjlab_core import Limits, NonNegative, Positive

from mjlab_actuators.actuator import COMMAND_FIELDS, CommandField
from mjlab_actuators.actuator_cfg import CtrlInput, EffortLimit, Gear
from mjlab_actuators.models.native import NativeActuatorCfg
from mjlab_actuators.transmission import limit_force

INPUTS: dict[CommandField, mujoco.mjtCtrlInput] = {
  "position_target": mujoco.mjtCtrlInput.mjINPUT_POS,
  "velocity_target": mujoco.mjtCtrlInput.mjINPUT_VEL,
  "effort_target": mujoco.mjtCtrlInput.mjINPUT_FF,
}
"""Inputs of MuJoCo's controllers by target, in the order in which MuJoCo lays them out in ctrl."""


@dataclass(kw_only=True)
class NativeDcMotorActuatorCfg(NativeActuatorCfg):
  """MuJoCo's DC motor: force = K (V - K w) / R, with w the speed of the motor, gear times that of the target.

  With `inputs="voltage"`, V is the effort target in volts. Otherwise a controller inside MuJoCo asks for the force
  kp (q* - q) + kd (q*' - q') + effort* at the joint, of which only the targets in `inputs` are there (the others count
  as zero), and V is the voltage that gives it, clamped to +-voltage_limit. Targets and gains are those of the joint, as
  of every other actuator; the other constants are those of the motor: either K and R, or `nominal`.
  """

  gear: Gear = 1.0
  """Reduction between motor and target; volts pass unchanged, and a controller has the gear inside."""
  torque_constant: Positive | None = None
  """K, which is the back-EMF constant too [N m/A = V s/rad]."""
  resistance: Positive | None = None
  """R [ohm]."""
  nominal: Annotated[tuple[float, float, float] | None, Limits(gt=0)] = None
  """Data sheet instead of K and R: voltage [V], stall torque [N m], no-load speed [rad/s]."""
  inputs: Literal["voltage"] | tuple[CommandField, ...] = "voltage"
  """Drive of the motor: a voltage, or some of the three targets through the controller."""
  stiffness: NonNegative = 0.0
  """kp of the controller, at the joint [N m/rad]."""
  damping: NonNegative = 0.0
  """kd of the controller, at the joint [N m s/rad]."""
  voltage_limit: Positive | None = None
  """Largest voltage [V]; None for no limit."""
  effort_limit: EffortLimit = None
  """Largest force of the motor, before the gear [N m]; None for no limit."""
  inductance: NonNegative = 0.0
  """L [H]; when positive the current lags with L / R and lives in the simulation's `act`."""
  integral_gain: NonNegative = 0.0
  """ki of the controller, on the position error of the joint [N m/(rad s)]; its integral lives in the simulation's
  `act`."""
  integral_limit: NonNegative = 0.0
  """Largest effort of the integral, at the joint [N m]; 0 for no limit."""
  slew_rate: NonNegative = 0.0
  """Largest change of the input [unit of the input/s]; 0 for no limit."""
  cogging: Annotated[tuple[float, float, float] | None, Limits()] = None
  """Amplitude a [N m], periods n per turn, and phase f [rad] of the torque a sin(n l + f); not limited by
  `effort_limit`."""
  lugre: Annotated[tuple[float, float, float, float, float] | None, Limits()] = None
  """Friction after the LuGre model, not limited either: stiffness [N m/rad] and damping [N m s/rad] of the bristles,
  Coulomb and static friction [N m], Stribeck velocity [rad/s]."""
  thermal: Annotated[tuple[float, float, float, float, float, float] | None, Limits()] = None
  """Winding that warms up: thermal resistance [K/W], heat capacity [J/K] and time constant [s], of which one may be 0
  and follows from the others; coefficient of the resistance [1/K]; temperature that `resistance` was measured at, and
  that of the surroundings."""

  def problems(self, target_names: Sequence[str]) -> Iterator[str]:
    """Yield problems of fields that keep their own constraints."""
    yield from super().problems(target_names)
    inputs, electrical = self.inputs, (self.torque_constant, self.resistance)
    if electrical.count(None) != (0 if self.nominal is None else 2):
      yield "give torque_constant and resistance, or nominal"
    if inputs == "voltage":
      if self.stiffness or self.damping or self.integral_gain:
        yield "stiffness, damping and integral_gain are a controller's; inputs 'voltage' has none"
      return
    if not inputs or len(set(inputs)) != len(inputs):
      yield f"inputs is {inputs!r}; name at least one target, each once"
    gains = {"position_target": self.stiffness, "velocity_target": self.damping}
    yield from (f"{name} is an input, but its gain is 0" for name, gain in gains.items() if name in inputs and not gain)
    if self.integral_gain > 0.0 and "position_target" not in inputs:
      yield "integral_gain is given, but inputs has no position_target to integrate the error of"

  def _reads_position(self) -> bool:
    return self.stiffness > 0.0

  def ctrl_inputs(self, model: mujoco.MjModel, element: int) -> list[CtrlInput]:
    """Return the targets in the order of MuJoCo's inputs; volts and targets of the controller have no gear."""
    fields = ("effort_target",) if self.inputs == "voltage" else self.inputs
    return [((field,), 1.0) for field in COMMAND_FIELDS if field in fields]

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    volts = self.voltage_limit or 0.0
    controlled = self.inputs != "voltage"
    voltage_input = [mujoco.mjtCtrlInput.mjINPUT_VOLTAGE]
    bits = voltage_input if self.inputs == "voltage" else [INPUTS[field] for field in self.inputs]
    # The constants of a motor with a controller are those at the joint, and so its inputs are those of the joint.
    turn = math.copysign(1.0, self.gear) if controlled else 1.0
    ratio = abs(self.gear) if controlled else 1.0
    constant = ratio * (self.torque_constant or 0.0)
    voltage, torque, speed = self.nominal or (0.0, 0.0, 0.0)
    amplitude, periods, phase = self.cogging or (0.0, 0.0, 0.0)
    bristle_stiffness, bristle_damping, coulomb, static, stribeck = self.lugre or (0.0,) * 5
    gear = 1.0 if controlled else self.gear
    for element, limit in self._bare_elements(spec, target_names, "effort_limit", gear=gear):
      element.set_to_dcmotor(
        motorconst=[constant, constant],
        resistance=self.resistance or 0.0,
        nominal=[voltage, ratio * torque, speed / ratio],
        inductance=[self.inductance, 0.0],
        cogging=[ratio * amplitude, ratio * periods, turn * phase],
        controller=[
          self.stiffness,
          self.integral_gain,
          self.damping,
          self.slew_rate,
          self.integral_limit,
          volts if controlled else 0.0,
        ],
        thermal=list(self.thermal or (0.0,) * 6),
        lugre=[
          ratio**2 * bristle_stiffness,
          ratio**2 * bristle_damping,
          ratio * coulomb,
          ratio * static,
          stribeck / ratio,
        ],
        ctrlspec=sum(int(bit) for bit in bits),
      )
      limit_force(element, ratio * limit)
      if volts and not controlled:
        element.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
        element.ctrlrange = [-volts, volts]
