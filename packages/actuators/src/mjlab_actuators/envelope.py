"""PD behind the measured torque-speed envelope of a geared motor, and the envelopes of Unitree's motors."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import torch

from mjlab_actuators.actuator import Actuator
from mjlab_actuators.command import ActuatorCmd
from mjlab_actuators.ideal_pd import Pd, PdActuatorCfg


class TorqueSpeedEnvelope(NamedTuple):
  """What a motor was measured to give, on the output side of its gearbox."""

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
  """A PD law limited by an envelope that knows driving from braking.

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

  envelope: TorqueSpeedEnvelope | Mapping[str, TorqueSpeedEnvelope]
  """One envelope for all targets, or envelopes by pattern (full match; every target by exactly one pattern)."""

  @property
  def law(self) -> type[Actuator]:
    return EnvelopedPd

  def parameters(self, target_names: Sequence[str]) -> dict[str, tuple[float, ...]]:
    envelopes = self._by_target("envelope", self.envelope, target_names)
    for target, envelope in zip(target_names, envelopes, strict=True):
      for name, value in envelope._asdict().items():
        if not (math.isfinite(value) and value >= 0.0) or (value == 0.0 and name != "full_effort_speed"):
          raise ValueError(f"{self._field_of(name, target)} is {value}; it must be finite and positive")
      for larger, smaller in (("no_load_speed", "full_effort_speed"), ("braking_effort", "motoring_effort")):
        low, high = getattr(envelope, smaller), getattr(envelope, larger)
        # Drive and brake may be equally strong; a line between two equal speeds has no slope.
        if high < low or (high == low and larger == "no_load_speed"):
          raise ValueError(
            f"{self._field_of(larger, target)} is {high}, not above its {smaller} {low}; the two may be swapped"
          )
    return super().parameters(target_names) | {
      name: tuple(float(getattr(envelope, name)) for envelope in envelopes) for name in TorqueSpeedEnvelope._fields
    }
