"""What an actuator is asked to do and what it may measure, for one physics substep."""

from dataclasses import dataclass
from typing import Literal

import torch

CommandField = Literal["position_target", "velocity_target", "effort_target"]
"""One of the three set-points of a joint."""

COMMAND_FIELDS: tuple[CommandField, ...] = ("position_target", "velocity_target", "effort_target")


@dataclass(slots=True)
class ActuatorCmd:
  """Set-points and measurements of n targets, one column each.

  Lengths are those of the target: metres for slides, radians for hinges; efforts are newtons or newton metres.
  """

  position_target: torch.Tensor
  """Wanted position, (num_envs, n) [m or rad]."""
  velocity_target: torch.Tensor
  """Wanted velocity, (num_envs, n) [m/s or rad/s]."""
  effort_target: torch.Tensor
  """Feed-forward effort, (num_envs, n) [N or N m]."""
  position: torch.Tensor
  """Measured position, (num_envs, n) [m or rad]."""
  velocity: torch.Tensor
  """Measured velocity, (num_envs, n) [m/s or rad/s]."""
