"""PD laws in torch, with feed-forward, whose gains and limits may differ per world and change at run time."""

import math
from abc import ABC
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import torch

from mjlab_actuators.actuator import Actuator, ActuatorGroup
from mjlab_actuators.actuator_cfg import ActuatorCfg, PerTarget, is_zero
from mjlab_actuators.command import ActuatorCmd


class Pd(Actuator, ABC):
  """What all PD laws ask for before they limit it: kp (q* - q) + kd (q*' - q') + effort*.

  Set-points are delayed, measurements are not. All parameters are (1, n) until `expand`ed; writes in place act from the
  next substep on.
  """

  stiffness: torch.Tensor
  """kp, (1, n) or (num_envs, n) [N/m or N m/rad]."""
  damping: torch.Tensor
  """kd, (1, n) or (num_envs, n) [N s/m or N m s/rad]."""

  def _wanted(self, cmd: ActuatorCmd) -> torch.Tensor:
    """The effort without any limit, (num_envs, n), in new memory; advances the delay."""
    position, velocity, effort = self._delayed_targets(cmd)
    effort = torch.addcmul(effort, self.stiffness, position - cmd.position)
    return effort.addcmul_(self.damping, velocity - cmd.velocity)


class IdealPd(Pd):
  """effort = clamp(kp (q* - q) + kd (q*' - q') + effort*, +-effort_limit)."""

  effort_limit: torch.Tensor
  """Largest effort, (1, n) or (num_envs, n) [N or N m]; infinite without a limit."""

  def __init__(
    self,
    group: ActuatorGroup,
    *,
    num_envs: int,
    device: torch.device | str,
    dtype: torch.dtype,
    generator: torch.Generator | None = None,
  ) -> None:
    super().__init__(group, num_envs=num_envs, device=device, dtype=dtype, generator=generator)
    self._clamps = not all(math.isinf(limit) for limit in group.parameters["effort_limit"])

  def compute(self, cmd: ActuatorCmd) -> torch.Tensor:
    effort = self._wanted(cmd)
    if self._clamps:
      torch.clamp(effort, -self.effort_limit, self.effort_limit, out=effort)
    return effort

  def expand(self, name: str) -> torch.Tensor:
    # Whoever wants limits per world is about to write some.
    self._clamps = self._clamps or name == "effort_limit"
    return super().expand(name)


@dataclass(kw_only=True)
class TorqueActuatorCfg(ActuatorCfg):
  """Base of all laws that torch computes and a MuJoCo motor applies.

  Limits live in the law alone: the motor underneath has no range, so a limit raised at run time takes effect (a joint's
  own `actuatorfrcrange`, where the MJCF has one, still applies).
  """

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    self._bare_elements(spec, target_names)


@dataclass(kw_only=True)
class PdActuatorCfg(TorqueActuatorCfg):
  """Base of PD laws computed in torch.

  The integrator cannot see the law's derivatives: keep kd below about 2 J / timestep, or take the native servo.
  """

  stiffness: PerTarget
  """kp [N/m or N m/rad]."""
  damping: PerTarget
  """kd [N s/m or N m s/rad]."""

  def _reads_position(self) -> bool:
    return not is_zero(self.stiffness)

  def parameters(self, target_names: Sequence[str]) -> dict[str, tuple[float, ...]]:
    return {
      "stiffness": self._numbers("stiffness", target_names),
      "damping": self._numbers("damping", target_names),
    }


@dataclass(kw_only=True)
class IdealPdActuatorCfg(PdActuatorCfg):
  """PD with feed-forward computed in torch each substep, clamped and applied as a torque."""

  effort_limit: PerTarget | None = None
  """Largest effort [N or N m]; None for no limit."""

  @property
  def law(self) -> type[Actuator]:
    return IdealPd

  def parameters(self, target_names: Sequence[str]) -> dict[str, tuple[float, ...]]:
    return super().parameters(target_names) | {"effort_limit": self._limits("effort_limit", target_names)}
