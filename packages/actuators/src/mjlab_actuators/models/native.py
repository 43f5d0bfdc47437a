"""Actuator models that MuJoCo computes: position servo, velocity servo, motor, PD. Torch hands the targets over."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import mujoco
import torch

from mjlab_actuators.actuator import COMMAND_FIELDS, Actuator, ActuatorCmd, CommandField
from mjlab_actuators.actuator_cfg import (
  ActuatorCfg,
  CtrlInput,
  EffortLimit,
  Gear,
  NonNegativePerTarget,
  PositivePerTarget,
)
from mjlab_actuators.transmission import Target, limit_force, range_of


class PassThrough(Actuator):
  """Ctrl is one target, delayed or not; the actuator model itself runs inside MuJoCo."""

  needs_feedback = False

  gear: torch.Tensor
  """Transmission length per position of the joint, (1, n)."""

  @cached_property
  def is_geared(self) -> bool:
    """True if ctrl is another number than the target."""
    return any(column.parameters["gear"] != 1.0 for column in self.columns)

  def compute(self, cmd: ActuatorCmd) -> torch.Tensor:
    """Return the target, as the actuator of MuJoCo takes it."""
    target = self._delayed_targets(cmd)[0]
    if not self.is_geared:
      return target
    # Targets are the joint's: an actuator moves `gear` times as far and as fast, and gives `gear` times its effort.
    return target / self.gear if self.group.command_fields == ("effort_target",) else target * self.gear


@dataclass(kw_only=True)
class NativeActuatorCfg(ActuatorCfg):
  """Base of all actuator models that MuJoCo computes."""

  actuator_model = PassThrough


@dataclass(kw_only=True)
class NativePositionActuatorCfg(NativeActuatorCfg):
  """MuJoCo's position servo: force = clamp(kp (u - q) - kd q', +-effort_limit), u = position target.

  Implicit integrators see the derivative of the force, so stiff gains stay stable. The target is never clamped: it may
  lie beyond the joint's range, so that the servo can press against something at the end of the range.
  """

  stiffness: NonNegativePerTarget
  """kp [N/m or N m/rad]."""
  damping: NonNegativePerTarget
  """kd [N s/m or N m s/rad]."""
  effort_limit: EffortLimit = None
  """Largest force [N or N m]; None for no limit."""

  command_fields: ClassVar[tuple[CommandField, ...]] = ("position_target",)

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    for element, kp, kd, limit in self._bare_elements(spec, target_names, "stiffness", "damping", "effort_limit"):
      element.set_to_position(kp=kp, kv=kd)
      limit_force(element, limit)
      low, high = range_of(spec, Target(self.transmission_type, element.target))
      # Beyond this range the force is saturated for every position in the joint's own: what sliders and spaces use.
      if high > low and kp > 0.0 and limit < float("inf"):
        element.ctrlrange = [low - limit / kp, high + limit / kp]


@dataclass(kw_only=True)
class NativeVelocityActuatorCfg(NativeActuatorCfg):
  """MuJoCo's velocity servo: force = clamp(kd (u - q'), +-effort_limit), u = velocity target."""

  damping: NonNegativePerTarget
  """kd [N s/m or N m s/rad]."""
  effort_limit: EffortLimit = None
  """Largest force [N or N m]; None for no limit."""

  command_fields: ClassVar[tuple[CommandField, ...]] = ("velocity_target",)

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    for element, kd, limit in self._bare_elements(spec, target_names, "damping", "effort_limit"):
      element.set_to_velocity(kv=kd)
      limit_force(element, limit)


@dataclass(kw_only=True)
class NativeMotorActuatorCfg(NativeActuatorCfg):
  """A torque source: effort = clamp(effort target, +-gear effort_limit), at the joint."""

  gear: Gear = 1.0
  """Reduction between motor and target: transmission length per position. A negative gear reverses ctrl."""
  effort_limit: EffortLimit = None
  """Largest effort of the motor, before the gear [N or N m]; None for no limit."""

  command_fields: ClassVar[tuple[CommandField, ...]] = ("effort_target",)

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    for element, limit in self._bare_elements(spec, target_names, "effort_limit", gear=self.gear):
      limit_force(element, limit)
      element.ctrlrange = element.forcerange

  def ctrl_inputs(self, model: mujoco.MjModel, element: int) -> list[CtrlInput]:
    """Return the one input."""
    return [(self.command_fields, self.gear)]


class NativePd(PassThrough):
  """Position servo whose ctrl also carries the targets of velocity and effort: u = q* + (kd q*' + effort*) / kp."""

  stiffness: torch.Tensor
  """kp, (1, n) or (num_envs, n) [N/m or N m/rad]; the servo in MuJoCo has the same."""
  damping: torch.Tensor
  """kd, (1, n) or (num_envs, n) [N s/m or N m s/rad]; the servo in MuJoCo has the same."""

  def compute(self, cmd: ActuatorCmd) -> torch.Tensor:
    """Return the position target that gives the effort of all three targets."""
    position, velocity, effort = self._delayed_targets(cmd)
    return position + torch.addcmul(effort, self.damping, velocity) / self.stiffness


@dataclass(kw_only=True)
class NativePdActuatorCfg(NativePositionActuatorCfg):
  """PD control inside MuJoCo: force = clamp(kp (q* - q) + kd (q*' - q') + effort*, +-effort_limit).

  Implicit integrators see the derivative of the force, so stiff gains stay stable; `IdealPdActuatorCfg` is the same in
  torch, without that. Each target has one actuator in MuJoCo, a position servo, so that the limit is on the sum.
  """

  stiffness: PositivePerTarget
  """kp [N/m or N m/rad]. Without stiffness, take `NativeVelocityActuatorCfg`."""

  command_fields: ClassVar[tuple[CommandField, ...]] = COMMAND_FIELDS
  actuator_model = NativePd
  number_fields = ("stiffness", "damping")
