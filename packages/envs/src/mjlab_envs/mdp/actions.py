"""Actions: the policy's output becomes targets of joints, tendons and sites."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import torch
from mjlab_core import Finite, Limits, MjlabError, where_
from mjlab_managers import ActionTargets

from mjlab_envs.mdp.driven_targets import DrivenJoints, DrivenTargets, DrivenTargetsCfg

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv


class AffineAction(DrivenTargets):
  """Base of actions with one column for each target: target = clip(scale * action + offset)."""

  def __init__(self, cfg: "AffineActionCfg", env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._scale = self._per_target(cfg.scale, "scale")
    default = self._default_offset()
    if default is not None and getattr(cfg, "use_default_offset", False):
      if cfg.offset is not None:
        raise MjlabError(f"offset requires use_default_offset=False; got offset={cfg.offset}")
      self._offset = default
    else:
      self._offset = self._per_target(0.0 if cfg.offset is None else cfg.offset, "offset")

  def _default_offset(self) -> torch.Tensor | None:
    """Return what `use_default_offset` means for this action, (1, targets); None if nothing."""
    return None

  @property
  def action_dim(self) -> int:
    return len(self.target_names)

  @property
  def scale(self) -> torch.Tensor:
    """Factor of each target, (1, targets)."""
    return self._scale

  @property
  def offset(self) -> torch.Tensor:
    """Offset of each target, (1, targets)."""
    return self._offset

  def target(self, actions: torch.Tensor) -> torch.Tensor:
    """Return the targets of raw actions, (num_envs, targets)."""
    target = torch.addcmul(self._offset, actions.to(self._scale.dtype), self._scale)
    return target if self._lo is None else target.clamp(self._lo, self._hi)

  def process_actions(self, actions: torch.Tensor) -> None:
    self._target.write(self.target(actions))

  def exported(self) -> ActionTargets | None:
    if self.transmission != "joint":
      return None
    return ActionTargets(quantity=self.quantity, joints=tuple(self.target_names), compute=self._traceable())

  def _traceable(self) -> Callable[[torch.Tensor], torch.Tensor]:
    """Return `target` with constants in float32 on the CPU."""
    scale, offset = self._scale.cpu().float(), self._offset[:1].cpu().float()
    bound = self._traceable_bounds()
    return lambda action: bound(offset + action * scale)


class JointPositionAction(AffineAction, DrivenJoints):
  """See `JointPositionActionCfg`."""

  @property
  def reach(self) -> torch.Tensor:
    """Absolute raw action whose target is the farther limit of a joint, infinite without limits, (1, targets)."""
    limits = self._entity.data.default_joint_pos_limits[:, self._q]
    return (limits - self._offset[:1, :, None]).abs().amax(-1) / self._scale.abs()

  def _default_offset(self) -> torch.Tensor:
    return self._entity.data.default_joint_pos[:, self._q].clone()

  def process_actions(self, actions: torch.Tensor) -> None:
    # The action of most tasks: `target` and `set_positions` in one call.
    target = torch.addcmul(self._offset, actions.to(self._scale.dtype), self._scale)
    if self._lo is not None:
      target = target.clamp(self._lo, self._hi)
    self._target.write(target - self._entity.data.encoder_bias[:, self._q])


class SmoothedJointPositionAction(JointPositionAction):
  """See `SmoothedJointPositionActionCfg`."""

  def __init__(self, cfg: "SmoothedJointPositionActionCfg", env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._weight = 1.0 - cfg.smoothing
    self._smoothed = self.state_of(self.measured_positions().clone())

  def exported(self) -> ActionTargets:
    reading, driven = self._position_reading()
    target, weight = self._traceable(), self._weight
    return ActionTargets(
      quantity=self.quantity,
      joints=tuple(self.target_names),
      compute=lambda action, last, _: torch.lerp(last, target(action), weight),
      readings=(reading,),
      start=driven,
    )

  def process_actions(self, actions: torch.Tensor) -> None:
    self._smoothed.lerp_(self.target(actions), self._weight)
    self.set_positions(self._smoothed)

  def reset(self, mask: torch.Tensor) -> None:
    where_(self._smoothed, mask, self.measured_positions())


class RelativeJointPositionAction(AffineAction, DrivenJoints):
  """See `RelativeJointPositionActionCfg`."""

  def __init__(self, cfg: "RelativeJointPositionActionCfg", env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._from_target = cfg.relative_to == "target"
    self._previous = self.state_of(self.measured_positions().clone())

  def exported(self) -> ActionTargets:
    reading, driven = self._position_reading()
    scale, offset = self._scale.cpu().float(), self._offset[:1].cpu().float()
    bound, from_target = self._traceable_bounds(), self._from_target
    return ActionTargets(
      quantity=self.quantity,
      joints=tuple(self.target_names),
      compute=lambda action, last, q: bound((last if from_target else driven(q)) + offset + action * scale),
      readings=(reading,),
      start=driven,
    )

  def process_actions(self, actions: torch.Tensor) -> None:
    base = self._previous if self._from_target else self.measured_positions()
    change = torch.addcmul(self._offset, actions.to(self._scale.dtype), self._scale)
    self._previous.copy_(self.clipped(base + change))
    self.set_positions(self._previous)

  def reset(self, mask: torch.Tensor) -> None:
    where_(self._previous, mask, self.measured_positions())


class BinaryJointPositionAction(DrivenJoints):
  """See `BinaryJointPositionActionCfg`."""

  def __init__(self, cfg: "BinaryJointPositionActionCfg", env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._open = self.clipped(self._per_target(cfg.open, "open"))
    self._close = self.clipped(self._per_target(cfg.close, "close"))

  @property
  def action_dim(self) -> int:
    return 1

  def exported(self) -> ActionTargets:
    opened, closed = self._open.cpu().float(), self._close.cpu().float()
    return ActionTargets(
      quantity=self.quantity,
      joints=tuple(self.target_names),
      compute=lambda action: torch.where(action < 0.0, closed, opened),
    )

  def process_actions(self, actions: torch.Tensor) -> None:
    self.set_positions(torch.where(actions < 0.0, self._close, self._open))


class JointVelocityAction(AffineAction, DrivenJoints):
  """See `JointVelocityActionCfg`."""

  quantity = "velocity"

  def _default_offset(self) -> torch.Tensor:
    return self._entity.data.default_joint_vel[:, self._v].clone()


class JointEffortAction(AffineAction, DrivenJoints):
  """See `JointEffortActionCfg`."""

  quantity = "effort"


class TendonLengthAction(AffineAction):
  """See `TendonLengthActionCfg`."""

  transmission = "tendon"


class TendonVelocityAction(AffineAction):
  """See `TendonVelocityActionCfg`."""

  transmission = "tendon"
  quantity = "velocity"


class TendonEffortAction(AffineAction):
  """See `TendonEffortActionCfg`."""

  transmission = "tendon"
  quantity = "effort"


class SiteEffortAction(AffineAction):
  """See `SiteEffortActionCfg`."""

  transmission = "site"
  quantity = "effort"


@dataclass(kw_only=True)
class AffineActionCfg(DrivenTargetsCfg):
  """Base of actions with one column for each target: target = clip(scale * action + offset)."""

  scale: Annotated[float | dict[str, float], Limits()] = 1.0
  """One factor, or one per target by pattern."""
  offset: Annotated[float | dict[str, float] | None, Limits()] = None
  """One offset, or one per target by pattern; None is 0, or the default that `use_default_offset` adds."""


@dataclass(kw_only=True)
class JointPositionActionCfg(AffineActionCfg):
  """Joint position targets [rad, m]; the encoders' bias is subtracted, as on a robot whose encoders have it."""

  use_default_offset: bool = True
  """Offset by the default pose; must be False if `offset` is given."""

  action = JointPositionAction


@dataclass(kw_only=True)
class JointVelocityActionCfg(AffineActionCfg):
  """Joint velocity targets [rad/s, m/s]."""

  use_default_offset: bool = True
  """Offset by the default velocities; must be False if `offset` is given."""

  action = JointVelocityAction


@dataclass(kw_only=True)
class JointEffortActionCfg(AffineActionCfg):
  """Joint effort targets [N m, N]."""

  action = JointEffortAction


@dataclass(kw_only=True)
class SmoothedJointPositionActionCfg(JointPositionActionCfg):
  """Joint position targets that follow the policy's through an exponential moving average.

  target_t = smoothing * target_{t-1} + (1 - smoothing) * clip(scale * action + offset), from the joint positions at
  the beginning of an episode.
  """

  smoothing: Annotated[float, Limits(ge=0, lt=1)] = 0.5
  """Share of the previous target in the new one, in [0, 1)."""

  action = SmoothedJointPositionAction


@dataclass(kw_only=True)
class RelativeJointPositionActionCfg(AffineActionCfg):
  """Joint position targets [rad, m] as differences: target = clip(base + scale * action + offset).

  The target is fixed once for each environment step.
  """

  relative_to: Literal["position", "target"] = "position"
  """Base: the joint positions at the start of the step, or the targets of the previous step."""

  action = RelativeJointPositionAction


@dataclass(kw_only=True)
class BinaryJointPositionActionCfg(DrivenTargetsCfg):
  """Gripper with one column: it opens for an action of 0 or more, and closes for a negative one."""

  open: dict[str, Finite]
  """Targets of the open gripper by joint pattern [rad, m]; each driven joint must have one."""
  close: dict[str, Finite]
  """Targets of the closed gripper, likewise."""

  action = BinaryJointPositionAction


@dataclass(kw_only=True)
class TendonLengthActionCfg(AffineActionCfg):
  """Tendon length targets [m, rad]."""

  action = TendonLengthAction


@dataclass(kw_only=True)
class TendonVelocityActionCfg(AffineActionCfg):
  """Targets of the rate of change of tendon lengths [m/s, rad/s]."""

  action = TendonVelocityAction


@dataclass(kw_only=True)
class TendonEffortActionCfg(AffineActionCfg):
  """Effort targets along tendons [N, N m]; positive ones push."""

  action = TendonEffortAction


@dataclass(kw_only=True)
class SiteEffortActionCfg(AffineActionCfg):
  """Effort targets at sites [N, N m]; the wrench is the effort times the gear of the actuator."""

  action = SiteEffortAction
