"""Laws that MuJoCo computes itself: position servo, velocity servo, motor. Torch only hands the set-point over."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import torch

from mjlab_actuators.actuator import Actuator, ActuatorCfg, PerTarget, add_joint_element, limit_force
from mjlab_actuators.command import ActuatorCmd, CommandField


class PassThrough(Actuator):
  """Ctrl is one set-point, delayed or not; the law itself runs inside MuJoCo."""

  needs_feedback = False

  def compute(self, cmd: ActuatorCmd) -> torch.Tensor:
    return self._delayed_targets(cmd)[0]


@dataclass(kw_only=True)
class NativePositionActuatorCfg(ActuatorCfg):
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

  @property
  def law(self) -> type[Actuator]:
    return PassThrough

  def validate(self, target_names: Sequence[str]) -> None:
    super().validate(target_names)
    self._gains(target_names)

  def _gains(self, target_names: Sequence[str]) -> list[tuple[str, float, float, float]]:
    return list(
      zip(
        target_names,
        self._numbers("stiffness", target_names),
        self._numbers("damping", target_names),
        self._limits("effort_limit", target_names),
        strict=True,
      )
    )

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    joints = {joint.name: joint for joint in spec.joints}
    for name, kp, kd, limit in self._gains(target_names):
      element = add_joint_element(spec, type(self).__name__, name)
      element.set_to_position(kp=kp, kv=kd)
      element.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
      limit_force(element, limit)
      low, high = joint_range(spec, joints[name])
      # Beyond this range the force is saturated for every position in the joint's own: what sliders and spaces use.
      if high > low and kp > 0.0 and math.isfinite(limit):
        element.ctrlrange = [low - limit / kp, high + limit / kp]


@dataclass(kw_only=True)
class NativeVelocityActuatorCfg(ActuatorCfg):
  """MuJoCo's velocity servo: force = clamp(kd (u - q'), +-effort_limit), u = velocity target."""

  damping: PerTarget
  """kd [N s/m or N m s/rad]."""
  effort_limit: PerTarget | None = None
  """Largest force [N or N m]; None for no limit."""

  command_fields: ClassVar[tuple[CommandField, ...]] = ("velocity_target",)

  @property
  def law(self) -> type[Actuator]:
    return PassThrough

  def validate(self, target_names: Sequence[str]) -> None:
    super().validate(target_names)
    self._numbers("damping", target_names)
    self._limits("effort_limit", target_names)

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    gains = self._numbers("damping", target_names)
    limits = self._limits("effort_limit", target_names)
    for name, kd, limit in zip(target_names, gains, limits, strict=True):
      element = add_joint_element(spec, type(self).__name__, name)
      element.set_to_velocity(kv=kd)
      limit_force(element, limit)


@dataclass(kw_only=True)
class NativeMotorActuatorCfg(ActuatorCfg):
  """A torque source: joint effort = gear clamp(u, +-effort_limit), u = effort target."""

  effort_limit: PerTarget | None = None
  """Largest |u|, before the gear [N or N m]; None for no limit."""
  gear: float = 1.0
  """Reduction between motor and joint; the effort target is on the motor's side. Negative turns the sense round."""

  command_fields: ClassVar[tuple[CommandField, ...]] = ("effort_target",)

  @property
  def law(self) -> type[Actuator]:
    return PassThrough

  def validate(self, target_names: Sequence[str]) -> None:
    super().validate(target_names)
    if not math.isfinite(self.gear) or self.gear == 0.0:
      raise ValueError(f"{type(self).__name__}: gear is {self.gear}; it must be finite and not zero")
    self._limits("effort_limit", target_names)

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    for name, limit in zip(target_names, self._limits("effort_limit", target_names), strict=True):
      element = add_joint_element(spec, type(self).__name__, name)
      element.gear = [self.gear, 0.0, 0.0, 0.0, 0.0, 0.0]
      limit_force(element, limit)
      if math.isfinite(limit):
        element.ctrlrange = [-limit, limit]


def joint_range(spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> tuple[float, float]:
  """Position limits of a joint [m or rad]; equal when there are none."""
  if joint.limited == mujoco.mjtLimited.mjLIMITED_FALSE:
    return 0.0, 0.0
  # A spec holds what the file says; the compiler turns degrees into radians later, in joints but not in actuators.
  unit = math.pi / 180.0 if spec.compiler.degree and joint.type == mujoco.mjtJoint.mjJNT_HINGE else 1.0
  return float(joint.range[0]) * unit, float(joint.range[1]) * unit
