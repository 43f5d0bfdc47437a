"""Laws that MuJoCo computes itself: position servo, velocity servo, motor. Torch only hands the set-point over."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import torch

from mjlab_actuators.actuator import Actuator
from mjlab_actuators.actuator_cfg import ActuatorCfg, PerTarget, is_zero
from mjlab_actuators.command import ActuatorCmd, CommandField
from mjlab_actuators.transmission import Target, limit_force, range_of


class PassThrough(Actuator):
  """Ctrl is one set-point, delayed or not; the law itself runs inside MuJoCo."""

  needs_feedback = False

  def compute(self, cmd: ActuatorCmd) -> torch.Tensor:
    return self._delayed_targets(cmd)[0]


@dataclass(kw_only=True)
class NativeActuatorCfg(ActuatorCfg):
  """Base of all laws that MuJoCo computes."""

  @property
  def law(self) -> type[Actuator]:
    return PassThrough

  def _check_gear(self, gear: float) -> None:
    if not math.isfinite(gear) or gear == 0.0:
      raise ValueError(f"{type(self).__name__}: gear is {gear}; it must be finite and not zero")


@dataclass(kw_only=True)
class NativePositionActuatorCfg(NativeActuatorCfg):
  """MuJoCo's position servo: force = clamp(kp (u - q) - kd q', +-effort_limit), u = position target.

  Implicit integrators see the derivative of the force, so stiff gains stay stable. The set-point is never clamped: it
  may lie beyond the joint's range, where a servo must aim to press against something at the range's end.
  """

  stiffness: PerTarget
  """kp [N/m or N m/rad]."""
  damping: PerTarget
  """kd [N s/m or N m s/rad]."""
  effort_limit: PerTarget | None = None
  """Largest force [N or N m]; None for no limit."""

  command_fields: ClassVar[tuple[CommandField, ...]] = ("position_target",)

  def validate(self, target_names: Sequence[str]) -> None:
    super().validate(target_names)
    self._gains(target_names)

  def _reads_position(self) -> bool:
    return not is_zero(self.stiffness)

  def _gains(self, target_names: Sequence[str]) -> list[tuple[float, float, float]]:
    return list(
      zip(
        self._numbers("stiffness", target_names),
        self._numbers("damping", target_names),
        self._limits("effort_limit", target_names),
        strict=True,
      )
    )

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    elements = self._bare_elements(spec, target_names)
    for name, element, (kp, kd, limit) in zip(target_names, elements, self._gains(target_names), strict=True):
      element.set_to_position(kp=kp, kv=kd)
      element.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
      limit_force(element, limit)
      low, high = range_of(spec, Target(self.transmission_type, name))
      # Beyond this range the force is saturated for every position in the joint's own: what sliders and spaces use.
      if high > low and kp > 0.0 and math.isfinite(limit):
        element.ctrlrange = [low - limit / kp, high + limit / kp]


@dataclass(kw_only=True)
class NativeVelocityActuatorCfg(NativeActuatorCfg):
  """MuJoCo's velocity servo: force = clamp(kd (u - q'), +-effort_limit), u = velocity target."""

  damping: PerTarget
  """kd [N s/m or N m s/rad]."""
  effort_limit: PerTarget | None = None
  """Largest force [N or N m]; None for no limit."""

  command_fields: ClassVar[tuple[CommandField, ...]] = ("velocity_target",)

  def validate(self, target_names: Sequence[str]) -> None:
    super().validate(target_names)
    self._numbers("damping", target_names)
    self._limits("effort_limit", target_names)

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    gains = self._numbers("damping", target_names)
    limits = self._limits("effort_limit", target_names)
    for element, kd, limit in zip(self._bare_elements(spec, target_names), gains, limits, strict=True):
      element.set_to_velocity(kv=kd)
      limit_force(element, limit)


@dataclass(kw_only=True)
class NativeMotorActuatorCfg(NativeActuatorCfg):
  """A torque source: effort = gear clamp(u, +-effort_limit), u = effort target."""

  effort_limit: PerTarget | None = None
  """Largest |u|, before the gear [N or N m]; None for no limit."""
  gear: float = 1.0
  """Reduction between motor and target; the effort target is on the motor's side. Negative turns the sense round."""

  command_fields: ClassVar[tuple[CommandField, ...]] = ("effort_target",)

  def validate(self, target_names: Sequence[str]) -> None:
    super().validate(target_names)
    self._check_gear(self.gear)
    self._limits("effort_limit", target_names)

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    elements = self._bare_elements(spec, target_names, self.gear)
    for element, limit in zip(elements, self._limits("effort_limit", target_names), strict=True):
      limit_force(element, limit)
      if math.isfinite(limit):
        element.ctrlrange = [-limit, limit]
