"""PD behind the measured torque-speed envelope of a geared motor, and the envelopes of Unitree's motors."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, NamedTuple

import torch
from mjlab_core import Limits

from mjlab_actuators.actuator import ActuatorCmd
from mjlab_actuators.models.ideal_pd import Pd, PdActuatorCfg


class TorqueSpeedEnvelope(NamedTuple):
  """Measured limits of a motor, on the output side of its gearbox."""

  full_effort_speed: float
  """Speed up to which the full motoring effort is there, the knee of the curve (Unitree's X1) [rad/s]."""
  no_load_speed: float
  """Speed at which no motoring effort is left (X2) [rad/s]."""
  motoring_effort: float
  """Peak effort in the sense of the motion (Y1) [N m]."""
  braking_effort: float
  """Peak effort against the motion and at rest (Y2) [N m]."""


UNITREE_ENVELOPES: Mapping[str, TorqueSpeedEnvelope] = MappingProxyType(
  {
    "Go2HV": TorqueSpeedEnvelope(13.5, 30.0, 20.2, 23.4),
    "N5010-16": TorqueSpeedEnvelope(27.0, 41.5, 9.5, 17.0),
    "N5020-16": TorqueSpeedEnvelope(30.86, 40.13, 24.8, 31.9),
    "N7520-14.3": TorqueSpeedEnvelope(22.63, 35.52, 71.0, 83.3),
    "N7520-22.5": TorqueSpeedEnvelope(14.5, 22.7, 111.0, 131.0),
    "W4010-25": TorqueSpeedEnvelope(15.3, 24.76, 4.8, 8.6),
    "M107-15": TorqueSpeedEnvelope(14.0, 25.6, 150.0, 182.8),
    "M107-24": TorqueSpeedEnvelope(8.8, 16.0, 240.0, 292.5),
  }
)
"""Envelopes by motor, as Unitree publishes them with its own training code, unitree_rl_lab."""


class EnvelopedPd(Pd):
  """PD limited by an envelope with separate limits for driving and braking.

  With e = kp (q* - q) + kd (q*' - q') + effort*, the effort is clamp(e, +-limit), where

    limit = motoring_effort clamp((no_load_speed - |q'|) / (no_load_speed - full_effort_speed), 0, 1)  if e q' > 0,
    limit = braking_effort                                                                            otherwise.

  A motor that turns faster than its no-load speed is left alone or brakes, as wanted; it is never driven on.
  """

  effort_limits = ("motoring_effort", "braking_effort")

  full_effort_speed: torch.Tensor
  """Knee of the curve, (1, n) or (num_envs, n) [m/s or rad/s]."""
  no_load_speed: torch.Tensor
  """Speed without motoring effort, (1, n) or (num_envs, n) [m/s or rad/s]; above `full_effort_speed`."""
  motoring_effort: torch.Tensor
  """Peak effort with the motion, (1, n) or (num_envs, n) [N or N m]."""
  braking_effort: torch.Tensor
  """Peak effort against the motion, (1, n) or (num_envs, n) [N or N m]."""

  def compute(self, cmd: ActuatorCmd) -> torch.Tensor:
    """Return the effort within the envelope."""
    effort = self._wanted(cmd)
    share = (self.no_load_speed - cmd.velocity.abs()) / (self.no_load_speed - self.full_effort_speed)
    motoring = share.clamp_(0.0, 1.0) * self.motoring_effort
    limit = torch.where(effort * cmd.velocity > 0.0, motoring, self.braking_effort)
    return torch.clamp(effort, -limit, limit, out=effort)


@dataclass(kw_only=True)
class EnvelopedPdActuatorCfg(PdActuatorCfg):
  """PD with feed-forward, limited by a torque-speed envelope such as those in `UNITREE_ENVELOPES`.

  The envelope limits what the motor gives. Friction of the gearbox belongs to the joint, where the integrator sees it:
  `frictionloss` and `viscous_damping`.
  """

  envelope: Annotated[TorqueSpeedEnvelope | Mapping[str, TorqueSpeedEnvelope], Limits(ge=0)]
  """One envelope for all targets, or envelopes by pattern (full match; every target by exactly one pattern)."""

  actuator_model = EnvelopedPd

  def problems(self, target_names: Sequence[str]) -> Iterator[str]:
    """Yield problems of fields that keep their own constraints."""
    yield from super().problems(target_names)
    envelopes: list[TorqueSpeedEnvelope] = self._by_target("envelope", target_names)
    for target, (knee, no_load, motoring, braking) in zip(target_names, envelopes, strict=True):
      # Drive and brake may be equally strong; a line between two equal speeds has no slope.
      if not (knee < no_load and 0.0 < motoring <= braking):
        yield (
          f"envelope of {self.transmission_type} {target!r} must have full_effort_speed {knee} below no_load_speed "
          f"{no_load}, and motoring_effort {motoring} above 0 and at most braking_effort {braking}"
        )

  def parameters(self, target_names: Sequence[str]) -> list[dict[str, float]]:
    """Return the gains and the numbers of the envelope for each target."""
    envelopes: list[TorqueSpeedEnvelope] = self._by_target("envelope", target_names)
    rows = zip(super().parameters(target_names), envelopes, strict=True)
    return [gains | envelope._asdict() for gains, envelope in rows]
