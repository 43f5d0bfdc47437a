"""Joint actions: from the policy's output to set-points of joints."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import torch
from mjlab_core.masking import where_
from mjlab_core.names import match_names, match_values_full
from mjlab_core.sampling import check_range
from mjlab_managers import ActionTerm, ActionTermCfg
from mjlab_scene.indexing import as_index

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv


@dataclass(kw_only=True)
class DrivenJointsCfg(ActionTermCfg):
  """Base of what gives set-points to joints."""

  entity: str = "robot"
  actuators: str | tuple[str, ...] = ".*"
  """Patterns of the joints that are driven, among those that have an actuator."""
  clip: tuple[float, float] | dict[str, tuple[float, float]] | None = None
  """Bounds of the set-point, or bounds by pattern; joints left out are not bounded."""
  preserve_order: bool = False
  """Order of the joints: of the patterns, or of the model."""


@dataclass(kw_only=True)
class JointActionCfg(DrivenJointsCfg):
  """Base of joint actions, one column for each joint: set-point = clip(scale * action + offset)."""

  scale: float | dict[str, float] = 1.0
  """One factor, or one per joint by pattern."""
  offset: float | dict[str, float] | None = None
  """One offset, or one per joint by pattern; None takes `use_default_offset`'s."""


@dataclass(kw_only=True)
class JointPositionActionCfg(JointActionCfg):
  """Joint position set-points [rad, m]; the encoders' bias is subtracted, as on a robot whose encoders have it."""

  use_default_offset: bool = True
  """Offset by the default pose. An `offset` of one's own must be given with False."""

  def build(self, env: Any) -> "JointPositionAction":
    return JointPositionAction(self, env)


@dataclass(kw_only=True)
class JointVelocityActionCfg(JointActionCfg):
  """Joint velocity set-points [rad/s, m/s]."""

  use_default_offset: bool = True
  """Offset by the default velocities. An `offset` of one's own must be given with False."""

  def build(self, env: Any) -> "JointVelocityAction":
    return JointVelocityAction(self, env)


@dataclass(kw_only=True)
class JointEffortActionCfg(JointActionCfg):
  """Joint efforts [N m, N]."""

  def build(self, env: Any) -> "JointEffortAction":
    return JointEffortAction(self, env)


@dataclass(kw_only=True)
class SmoothedJointPositionActionCfg(JointPositionActionCfg):
  """Joint position set-points that follow the policy's through an exponential moving average.

  target_t = smoothing * target_{t-1} + (1 - smoothing) * clip(scale * action + offset), from where the joints are when
  an episode begins.
  """

  smoothing: float = 0.5
  """Share of the old set-point in the new one, in [0, 1)."""

  def build(self, env: Any) -> "SmoothedJointPositionAction":
    return SmoothedJointPositionAction(self, env)


@dataclass(kw_only=True)
class RelativeJointPositionActionCfg(JointActionCfg):
  """Joint position set-points [rad, m] as differences: set-point = clip(base + scale * action + offset).

  It is fixed once for each environment step, so that it does not run ahead within one.
  """

  relative_to: Literal["position", "target"] = "position"
  """Base: where the joints are at the start of the step, or where they were to be in the step before."""

  def build(self, env: Any) -> "RelativeJointPositionAction":
    return RelativeJointPositionAction(self, env)


@dataclass(kw_only=True)
class BinaryJointPositionActionCfg(DrivenJointsCfg):
  """Two positions and one column between them: a gripper that opens for an action of 0 or more, and closes below."""

  open: dict[str, float]
  """Set-points of the open gripper by joint pattern [rad, m]; each driven joint must have one."""
  close: dict[str, float]
  """Those of the closed one."""

  def build(self, env: Any) -> "BinaryJointPositionAction":
    return BinaryJointPositionAction(self, env)


class DrivenJoints(ActionTerm):
  """Base of what gives set-points to joints: which they are, and between what bounds, (1, joints)."""

  _constants = frozenset({"_ids", "_q", "_v", "_lo", "_hi"})

  def __init__(self, cfg: DrivenJointsCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._entity = env.scene[cfg.entity]
    owner = f"entity '{cfg.entity}'"
    driven = () if self._entity.actuators is None else self._entity.actuators.driven("joint")
    actuated = [name for name in self._entity.joint_names if name in driven]
    _, self.joint_names = match_names(
      cfg.actuators, actuated, what="actuated joint", owner=owner, preserve_order=cfg.preserve_order
    )
    ids, ix = [self._entity.joint_names.index(name) for name in self.joint_names], self._entity.indexing
    self._ids = as_index(ids, env.device)
    # The same joints as columns of positions and of velocities; what is actuated has one of each.
    self._q, self._v = (as_index([of[i][0] for i in ids], env.device) for of in (ix.q_of_joint, ix.v_of_joint))
    self._owner = owner
    self._constant: dict[str, Any] = {"device": env.device, "dtype": env.sim.dtype}
    self._lo, self._hi = self._bounds(cfg)

  def _per_joint(self, values: float | Mapping[str, float], what: str) -> torch.Tensor:
    numbers = match_values_full(values, self.joint_names, what="joint", owner=f"{self._owner}: {what}")
    return torch.tensor([numbers], **self._constant)

  def _bounds(self, cfg: DrivenJointsCfg) -> tuple[torch.Tensor | None, torch.Tensor | None]:
    if cfg.clip is None:
      return None, None
    endless = (-float("inf"), float("inf"))
    by_pattern = {".*": cfg.clip} if isinstance(cfg.clip, tuple) else cfg.clip
    for pattern, bounds in by_pattern.items():
      check_range(f"clip['{pattern}']", *bounds)
    owner = f"{self._owner}: clip"
    bounds = match_values_full(by_pattern, self.joint_names, what="joint", owner=owner, default=endless)
    table = torch.tensor([bounds], **self._constant)
    return table[..., 0], table[..., 1]

  @property
  def driven(self) -> frozenset[str]:
    return frozenset(f"{self.cfg.entity}/{name}" for name in self.joint_names)

  def clipped(self, target: torch.Tensor) -> torch.Tensor:
    """Set-points within the bounds of `clip`, (num_envs, joints)."""
    return target if self._lo is None else target.clamp(self._lo, self._hi)

  def set_positions(self, target: torch.Tensor) -> None:
    """Set-points (num_envs, joints) as the encoders would read them, so without their bias."""
    bias = self._entity.data.encoder_bias[:, self._q]
    self._entity.set_joint_position_target(target - bias, joint_ids=self._ids)

  def measured_positions(self) -> torch.Tensor:
    """Joint positions as the encoders read them, (num_envs, joints) [rad, m]."""
    return self._entity.data.joint_pos_biased[:, self._q]

  def apply_actions(self) -> None:
    """Nothing: a set-point holds until the next one."""


class JointAction(DrivenJoints):
  """Base of joint actions: the affine map and its constants, (1, joints)."""

  _constants = frozenset({"_scale", "_offset"})

  def __init__(self, cfg: JointActionCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._scale = self._per_joint(cfg.scale, "scale")
    default = self._default_offset()
    if default is not None and getattr(cfg, "use_default_offset", False):
      if cfg.offset is not None:
        raise ValueError(
          f"offset is given, and use_default_offset is on: which one? Set use_default_offset=False to use {cfg.offset}"
        )
      self._offset = default
    else:
      self._offset = self._per_joint(0.0 if cfg.offset is None else cfg.offset, "offset")

  def _default_offset(self) -> torch.Tensor | None:
    """What `use_default_offset` means for this action, (1, joints); None if nothing."""
    return None

  @property
  def action_dim(self) -> int:
    return len(self.joint_names)

  @property
  def scale(self) -> torch.Tensor:
    """Factor of each joint, (1, joints)."""
    return self._scale

  @property
  def offset(self) -> torch.Tensor:
    """Offset of each joint, (1, joints)."""
    return self._offset

  def target(self, actions: torch.Tensor) -> torch.Tensor:
    """Set-points of raw actions, (num_envs, joints)."""
    return self.clipped(torch.addcmul(self._offset, actions.to(self._scale.dtype), self._scale))


class JointPositionAction(JointAction):
  """See `JointPositionActionCfg`."""

  def _default_offset(self) -> torch.Tensor:
    return self._entity.data.default_joint_pos[:, self._q].clone()

  def process_actions(self, actions: torch.Tensor) -> None:
    self.set_positions(self.target(actions))


class SmoothedJointPositionAction(JointPositionAction):
  """See `SmoothedJointPositionActionCfg`."""

  def __init__(self, cfg: SmoothedJointPositionActionCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    if not 0.0 <= cfg.smoothing < 1.0:
      raise ValueError(f"smoothing must be in [0, 1), got {cfg.smoothing}")
    self._weight = 1.0 - cfg.smoothing
    self._smoothed = self.measured_positions().clone()

  def process_actions(self, actions: torch.Tensor) -> None:
    self._smoothed.lerp_(self.target(actions), self._weight)
    self.set_positions(self._smoothed)

  def reset(self, mask: torch.Tensor) -> None:
    where_(self._smoothed, mask, self.measured_positions())


class RelativeJointPositionAction(JointAction):
  """See `RelativeJointPositionActionCfg`."""

  def __init__(self, cfg: RelativeJointPositionActionCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    if cfg.relative_to not in ("position", "target"):
      raise ValueError(f"relative_to must be 'position' or 'target', got {cfg.relative_to!r}")
    self._from_target = cfg.relative_to == "target"
    self._target = self.measured_positions().clone()

  def process_actions(self, actions: torch.Tensor) -> None:
    base = self._target if self._from_target else self.measured_positions()
    change = torch.addcmul(self._offset, actions.to(self._scale.dtype), self._scale)
    self._target.copy_(self.clipped(base + change))
    self.set_positions(self._target)

  def reset(self, mask: torch.Tensor) -> None:
    where_(self._target, mask, self.measured_positions())


class BinaryJointPositionAction(DrivenJoints):
  """See `BinaryJointPositionActionCfg`."""

  _constants = frozenset({"_open", "_close"})

  def __init__(self, cfg: BinaryJointPositionActionCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._open = self.clipped(self._per_joint(cfg.open, "open"))
    self._close = self.clipped(self._per_joint(cfg.close, "close"))

  @property
  def action_dim(self) -> int:
    return 1

  def process_actions(self, actions: torch.Tensor) -> None:
    self.set_positions(torch.where(actions < 0.0, self._close, self._open))


class JointVelocityAction(JointAction):
  """See `JointVelocityActionCfg`."""

  def _default_offset(self) -> torch.Tensor:
    return self._entity.data.default_joint_vel[:, self._v].clone()

  def process_actions(self, actions: torch.Tensor) -> None:
    self._entity.set_joint_velocity_target(self.target(actions), joint_ids=self._ids)


class JointEffortAction(JointAction):
  """See `JointEffortActionCfg`."""

  def process_actions(self, actions: torch.Tensor) -> None:
    self._entity.set_joint_effort_target(self.target(actions), joint_ids=self._ids)
