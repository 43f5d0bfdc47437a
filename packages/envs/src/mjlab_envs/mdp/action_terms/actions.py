"""Actions: the policy's output becomes targets of joints, tendons and sites."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import torch
from mjlab_core import Finite, Limits, MjlabError, where_
from mjlab_managers import ActionTargets

from mjlab_envs.mdp.action_terms.driven_targets import DrivenTargets, DrivenTargetsCfg
from mjlab_envs.mdp.readings import joints, selected

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv

Positions = Callable[[], torch.Tensor]
"""Function that returns the positions of the driven joints, (num_envs, joints) [rad, m]."""


class AffineAction(DrivenTargets):
  """Action with one column for each target: target = clip(scale * action + offset)."""

  def __init__(self, cfg: "AffineActionCfg", env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self.scale = self._per_target(cfg.scale, "scale")
    """Factor of each target, (1, targets)."""
    self.offset = self._per_target(0.0 if cfg.offset is None else cfg.offset, "offset")
    """Offset of each target, (1 or num_envs, targets)."""
    if getattr(cfg, "use_default_offset", False):
      if cfg.offset is not None:
        raise MjlabError(f"offset requires use_default_offset=False; got offset={cfg.offset}")
      data = self._entity.data
      is_position = cfg.quantity == "position"
      default = data.default_joint_pos[:, self._q] if is_position else data.default_joint_vel[:, self._v]
      self.offset = default.clone()

  @property
  def action_dim(self) -> int:
    return len(self.target_names)

  @property
  def reach(self) -> torch.Tensor | None:
    """Absolute raw action whose target is the farther limit of a joint, infinite without limits, (1, targets).

    None unless the targets are joint positions. Off-policy learners bound their actions by it.
    """
    if (self.transmission, self.quantity) != ("joint", "position"):
      return None
    limits = self._entity.data.default_joint_pos_limits[:, self._q]
    return (limits - self.offset[:1, :, None]).abs().amax(-1) / self.scale.abs()

  def affine(self, actions: torch.Tensor) -> torch.Tensor:
    """Return scale * action + offset of raw actions, (num_envs, targets)."""
    return torch.addcmul(self.offset, actions.to(self.scale.dtype), self.scale)

  def process_actions(self, actions: torch.Tensor) -> None:
    # The action of most tasks: `affine`, `clipped` and `set_targets` in one call.
    target = torch.addcmul(self.offset, actions.to(self.scale.dtype), self.scale)
    if self._lo is not None:
      target = target.clamp(self._lo, self._hi)
    if self._has_bias:
      target = target - self._entity.data.encoder_bias[:, self._q]
    self._target.write(target)

  def exported(self) -> ActionTargets | None:
    if self.transmission != "joint":
      return None
    twin = self._on_cpu()
    return self._export(lambda action: twin.clipped(twin.affine(action)))


class _FollowingAction(AffineAction):
  """Base of actions whose targets depend on the last ones, which are the joint positions when an episode begins."""

  def __init__(self, cfg: "AffineActionCfg", env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._previous = self.state_of(self.measured_positions().clone())

  @abstractmethod
  def next_targets(self, action: torch.Tensor, last: torch.Tensor, positions: Positions) -> torch.Tensor:
    """Return targets from the raw action, the last targets and the joint positions, (num_envs, targets)."""

  def process_actions(self, actions: torch.Tensor) -> None:
    self._previous.copy_(self.next_targets(actions, self._previous, self.measured_positions))
    self.set_targets(self._previous)

  def exported(self) -> ActionTargets:
    twin, reading = self._on_cpu(), joints(self.env, self.cfg.entity, "position")
    driven = selected(self._ids, torch.zeros(1, len(reading.columns)))

    def compute(action: torch.Tensor, last: torch.Tensor, positions: torch.Tensor) -> torch.Tensor:
      return twin.next_targets(action, last, lambda: driven(positions))

    return self._export(compute, readings=(reading,), start=driven)

  def reset(self, mask: torch.Tensor) -> None:
    where_(self._previous, mask, self.measured_positions())


class SmoothedJointPositionAction(_FollowingAction):
  """See `SmoothedJointPositionActionCfg`."""

  cfg: "SmoothedJointPositionActionCfg"

  def next_targets(self, action: torch.Tensor, last: torch.Tensor, positions: Positions) -> torch.Tensor:
    del positions
    return torch.lerp(last, self.clipped(self.affine(action)), 1.0 - self.cfg.smoothing)


class RelativeJointPositionAction(_FollowingAction):
  """See `RelativeJointPositionActionCfg`."""

  cfg: "RelativeJointPositionActionCfg"

  @property
  def reach(self) -> None:
    """None: the targets depend on the last ones."""
    return None

  def next_targets(self, action: torch.Tensor, last: torch.Tensor, positions: Positions) -> torch.Tensor:
    base = last if self.cfg.relative_to == "target" else positions()
    return self.clipped(base + self.affine(action))


class BinaryJointPositionAction(DrivenTargets):
  """See `BinaryJointPositionActionCfg`."""

  def __init__(self, cfg: "BinaryJointPositionActionCfg", env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._open = self.clipped(self._per_target(cfg.open, "open"))
    self._close = self.clipped(self._per_target(cfg.close, "close"))

  @property
  def action_dim(self) -> int:
    return 1

  def chosen(self, actions: torch.Tensor) -> torch.Tensor:
    """Return the targets of the open or the closed gripper, (num_envs, targets)."""
    return torch.where(actions < 0.0, self._close, self._open)

  def process_actions(self, actions: torch.Tensor) -> None:
    self.set_targets(self.chosen(actions))

  def exported(self) -> ActionTargets:
    return self._export(self._on_cpu().chosen)


@dataclass(kw_only=True)
class AffineActionCfg(DrivenTargetsCfg):
  """Base of actions with one column for each target: target = clip(scale * action + offset)."""

  scale: Annotated[float | dict[str, float], Limits()] = 1.0
  """One factor, or one per target by pattern."""
  offset: Annotated[float | dict[str, float] | None, Limits()] = None
  """One offset, or one per target by pattern; None is 0, or the default that `use_default_offset` adds."""

  action = AffineAction


@dataclass(kw_only=True)
class JointPositionActionCfg(AffineActionCfg):
  """Joint position targets [rad, m]; the encoders' bias is subtracted, as on a robot whose encoders have it."""

  use_default_offset: bool = True
  """Offset by the default pose; must be False if `offset` is given."""


@dataclass(kw_only=True)
class JointVelocityActionCfg(AffineActionCfg):
  """Joint velocity targets [rad/s, m/s]."""

  use_default_offset: bool = True
  """Offset by the default velocities; must be False if `offset` is given."""

  quantity = "velocity"


@dataclass(kw_only=True)
class JointEffortActionCfg(AffineActionCfg):
  """Joint effort targets [N m, N]."""

  quantity = "effort"


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

  transmission = "tendon"


@dataclass(kw_only=True)
class TendonVelocityActionCfg(AffineActionCfg):
  """Targets of the rate of change of tendon lengths [m/s, rad/s]."""

  transmission = "tendon"
  quantity = "velocity"


@dataclass(kw_only=True)
class TendonEffortActionCfg(AffineActionCfg):
  """Effort targets along tendons [N, N m]; positive ones push."""

  transmission = "tendon"
  quantity = "effort"


@dataclass(kw_only=True)
class SiteEffortActionCfg(AffineActionCfg):
  """Effort targets at sites [N, N m]; the wrench is the effort times the gear of the actuator."""

  transmission = "site"
  quantity = "effort"
