"""PD with the limits of a DC motor: the effort falls with speed."""

from dataclasses import dataclass, field
from typing import Annotated

import torch
from mjlab_core import Limits

from mjlab_actuators.actuator import ActuatorCmd
from mjlab_actuators.actuator_cfg import EffortLimit, PerTarget, PositivePerTarget
from mjlab_actuators.models.ideal_pd import Pd, PdActuatorCfg


def clip_to_dc_motor(
  effort: torch.Tensor,
  velocity: torch.Tensor,
  *,
  saturation_effort: torch.Tensor,
  velocity_limit: torch.Tensor,
  effort_limit: torch.Tensor,
  braking: bool,
) -> torch.Tensor:
  """Limit `effort` in place to what a DC motor at full voltage gives at this velocity, and return it.

  The voltage balance of a motor, V = i R + K w with effort K i, makes the effort at full voltage a straight line of the
  velocity, from the stall effort S down to zero at the no-load speed W (K. Lynch and F. Park, *Modern Robotics*,
  section 8.9.1). With F the limit of the drive's current, the bounds are

    upper = min(S (1 - v / W), F) and lower = max(-S (1 + v / W), -F).

  Beyond W the line changes its sign. Without `braking` the bound stops at zero there: the motor cannot drive the motion
  on, and nothing forces it to brake. With `braking` it goes on to -F, as in a drive that cannot switch its bridge off:
  the back EMF then exceeds the supply and brakes, for any wanted effort.

  Args:
    effort: Wanted effort, (num_envs, n) [N or N m].
    velocity: Measured velocity, (num_envs, n) [m/s or rad/s].
    saturation_effort: S, positive and finite, broadcasts to (num_envs, n) [N or N m].
    velocity_limit: W, positive and finite, broadcasts likewise [m/s or rad/s].
    effort_limit: F, positive, infinite without a limit, broadcasts likewise [N or N m].
    braking: True if the motor is forced to brake beyond its no-load speed.
  """
  drop = velocity * (saturation_effort / velocity_limit)
  upper = torch.minimum(saturation_effort - drop, effort_limit)
  lower = torch.minimum(saturation_effort + drop, effort_limit)
  if braking:
    floor = -effort_limit
    upper, lower = torch.maximum(upper, floor), torch.maximum(lower, floor)
  else:
    upper.clamp_min_(0.0)
    lower.clamp_min_(0.0)
  return torch.clamp(effort, lower.neg_(), upper, out=effort)


class DcMotor(Pd):
  """effort = clamp(kp (q* - q) + kd (q*' - q') + effort*, lower(q'), upper(q')); bounds as in `clip_to_dc_motor`."""

  saturation_effort: torch.Tensor
  """Stall effort, (1, n) or (num_envs, n) [N or N m]."""
  velocity_limit: torch.Tensor
  """No-load speed, (1, n) or (num_envs, n) [m/s or rad/s]."""
  effort_limit: torch.Tensor
  """Largest effort of the drive, (1, n) or (num_envs, n) [N or N m]; infinite without a limit."""
  braking: bool
  """True if the motor is forced to brake beyond its no-load speed."""

  def compute(self, cmd: ActuatorCmd) -> torch.Tensor:
    """Return the effort within the bounds of the motor."""
    return clip_to_dc_motor(
      self._wanted(cmd),
      cmd.velocity,
      saturation_effort=self.saturation_effort,
      velocity_limit=self.velocity_limit,
      effort_limit=self.effort_limit,
      braking=self.braking,
    )


@dataclass(kw_only=True)
class DcMotorActuatorCfg(PdActuatorCfg):
  """PD with feed-forward, limited by the torque-speed line of a DC motor; all on the joint's side of the gearbox."""

  saturation_effort: PositivePerTarget
  """Effort at stall and full voltage [N or N m]."""
  velocity_limit: Annotated[PerTarget | None, Limits(gt=0)] = field()
  """No-load speed at full voltage [m/s or rad/s]; None for an effort that does not fall with speed."""
  effort_limit: EffortLimit = None
  """Largest effort that the drive's current allows, in both senses [N or N m]; None for no limit. It may exceed the
  stall effort: a motor that is driven backwards gives more than that."""
  braking: bool = False
  """True if the motor is forced to brake where it turns faster than its no-load speed; see `clip_to_dc_motor`."""

  actuator_model = DcMotor
  number_fields = ("stiffness", "damping", "saturation_effort", "velocity_limit", "effort_limit")
  setting_fields = ("braking",)
