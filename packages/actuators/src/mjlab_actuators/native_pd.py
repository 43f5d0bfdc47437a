"""PD control inside MuJoCo, with targets of position, velocity and effort and one limit on their sum."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch

from mjlab_actuators.actuator import COMMAND_FIELDS, ActuatorCmd, CommandField
from mjlab_actuators.actuator_cfg import PositivePerTarget
from mjlab_actuators.native import NativePositionActuatorCfg, PassThrough


class NativePd(PassThrough):
  """Position servo whose ctrl also carries the targets of velocity and effort: u = q* + (kd q*' + effort*) / kp."""

  stiffness: torch.Tensor
  """kp, (1, n) or (num_envs, n) [N/m or N m/rad]; the servo in MuJoCo has the same."""
  damping: torch.Tensor
  """kd, (1, n) or (num_envs, n) [N s/m or N m s/rad]; the servo in MuJoCo has the same."""

  @property
  def is_geared(self) -> bool:
    """True: ctrl is another number than the position target."""
    return True

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

  def parameters(self, target_names: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """Return the gains."""
    return self._numbers(target_names, "stiffness", "damping")
