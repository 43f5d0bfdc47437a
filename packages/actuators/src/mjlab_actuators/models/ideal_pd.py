"""PD control in torch, with feed-forward; gains and limits may differ per world and change at run time."""

from abc import ABC
from dataclasses import dataclass
from typing import ClassVar

import torch

from mjlab_actuators.actuator import Actuator, ActuatorCmd
from mjlab_actuators.actuator_cfg import ActuatorCfg, EffortLimit, NonNegativePerTarget


class Pd(Actuator, ABC):
  """Base of PD models: kp (q* - q) + kd (q*' - q') + effort*, before any limit.

  Targets are delayed, measurements are not. All parameters are (1, n) until `expand`ed; writes in place act from the
  next substep on.
  """

  stiffness: torch.Tensor
  """kp, (1, n) or (num_envs, n) [N/m or N m/rad]."""
  damping: torch.Tensor
  """kd, (1, n) or (num_envs, n) [N s/m or N m s/rad]."""

  def _wanted(self, cmd: ActuatorCmd) -> torch.Tensor:
    """Return the effort without any limit, (num_envs, n), in new memory; advance the delay."""
    position, velocity, effort = self._delayed_targets(cmd)
    effort = torch.addcmul(effort, self.stiffness, position - cmd.position)
    return effort.addcmul_(self.damping, velocity - cmd.velocity)


class IdealPd(Pd):
  """effort = clamp(kp (q* - q) + kd (q*' - q') + effort*, +-effort_limit)."""

  effort_limit: torch.Tensor
  """Largest effort, (1, n) or (num_envs, n) [N or N m]; infinite without a limit."""

  def compute(self, cmd: ActuatorCmd) -> torch.Tensor:
    """Return the clamped effort."""
    effort = self._wanted(cmd)
    return torch.clamp(effort, -self.effort_limit, self.effort_limit, out=effort)


@dataclass(kw_only=True)
class PdActuatorCfg(ActuatorCfg):
  """Base of PD control computed in torch.

  The integrator cannot see the derivatives of the effort: keep kd below about 2 J / timestep, or take the native servo.
  """

  stiffness: NonNegativePerTarget
  """kp [N/m or N m/rad]."""
  damping: NonNegativePerTarget
  """kd [N s/m or N m s/rad]."""

  number_fields: ClassVar[tuple[str, ...]] = ("stiffness", "damping")


@dataclass(kw_only=True)
class IdealPdActuatorCfg(PdActuatorCfg):
  """PD with feed-forward computed in torch each substep, clamped and applied as a torque."""

  effort_limit: EffortLimit = None
  """Largest effort [N or N m]; None for no limit."""

  actuator_model = IdealPd
  number_fields = ("stiffness", "damping", "effort_limit")
