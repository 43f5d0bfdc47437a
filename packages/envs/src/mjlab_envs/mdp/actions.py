"""From the policy's output to set-points of joints, tendons and sites."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import torch
from mjlab_actuators import Transmission
from mjlab_core.masking import where_
from mjlab_core.names import match_names, match_values_full
from mjlab_core.sampling import check_bounds
from mjlab_managers import ActionTerm, ActionTermCfg
from mjlab_scene.indexing import as_index

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv


@dataclass(kw_only=True)
class DrivenTargetsCfg(ActionTermCfg):
  """Base of what gives set-points to joints, tendons or sites, here called targets."""

  entity: str = "robot"
  actuators: str | tuple[str, ...] = ".*"
  """Patterns of the targets, among those that have an actuator."""
  clip: tuple[float, float] | dict[str, tuple[float, float]] | None = None
  """Bounds of the set-point, or bounds by pattern; targets left out are not bounded."""
  preserve_order: bool = False
  """Order of the targets: of the patterns, or of the model."""


@dataclass(kw_only=True)
class AffineActionCfg(DrivenTargetsCfg):
  """Base of actions with one column for each target: set-point = clip(scale * action + offset)."""

  scale: float | dict[str, float] = 1.0
  """One factor, or one per target by pattern."""
  offset: float | dict[str, float] | None = None
  """One offset, or one per target by pattern; None takes that of `use_default_offset`, where there is one, or 0."""


@dataclass(kw_only=True)
class JointPositionActionCfg(AffineActionCfg):
  """Joint position set-points [rad, m]; the encoders' bias is subtracted, as on a robot whose encoders have it."""

  use_default_offset: bool = True
  """Offset by the default pose. An `offset` of one's own must be given with False."""

  def build(self, env: Any) -> "JointPositionAction":
    return JointPositionAction(self, env)


@dataclass(kw_only=True)
class JointVelocityActionCfg(AffineActionCfg):
  """Joint velocity set-points [rad/s, m/s]."""

  use_default_offset: bool = True
  """Offset by the default velocities. An `offset` of one's own must be given with False."""

  def build(self, env: Any) -> "JointVelocityAction":
    return JointVelocityAction(self, env)


@dataclass(kw_only=True)
class JointEffortActionCfg(AffineActionCfg):
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
class RelativeJointPositionActionCfg(AffineActionCfg):
  """Joint position set-points [rad, m] as differences: set-point = clip(base + scale * action + offset).

  It is fixed once for each environment step, so that it does not run ahead within one.
  """

  relative_to: Literal["position", "target"] = "position"
  """Base: where the joints are at the start of the step, or where they were to be in the step before."""

  def build(self, env: Any) -> "RelativeJointPositionAction":
    return RelativeJointPositionAction(self, env)


@dataclass(kw_only=True)
class BinaryJointPositionActionCfg(DrivenTargetsCfg):
  """Two positions and one column between them: a gripper that opens for an action of 0 or more, and closes below."""

  open: dict[str, float]
  """Set-points of the open gripper by joint pattern [rad, m]; each driven joint must have one."""
  close: dict[str, float]
  """Those of the closed one."""

  def build(self, env: Any) -> "BinaryJointPositionAction":
    return BinaryJointPositionAction(self, env)


@dataclass(kw_only=True)
class TendonLengthActionCfg(AffineActionCfg):
  """Tendon length set-points [m, rad]."""

  def build(self, env: Any) -> "TendonLengthAction":
    return TendonLengthAction(self, env)


@dataclass(kw_only=True)
class TendonVelocityActionCfg(AffineActionCfg):
  """Set-points of how fast tendons grow longer [m/s, rad/s]."""

  def build(self, env: Any) -> "TendonVelocityAction":
    return TendonVelocityAction(self, env)


@dataclass(kw_only=True)
class TendonEffortActionCfg(AffineActionCfg):
  """Efforts along tendons [N, N m]; positive ones push."""

  def build(self, env: Any) -> "TendonEffortAction":
    return TendonEffortAction(self, env)


@dataclass(kw_only=True)
class SiteEffortActionCfg(AffineActionCfg):
  """Efforts at sites [N, N m]: times the gear of the actuator they are the wrench."""

  def build(self, env: Any) -> "SiteEffortAction":
    return SiteEffortAction(self, env)


class DrivenTargets(ActionTerm):
  """Base of what gives set-points to joints, tendons or sites: which, and between what bounds, (1, targets)."""

  transmission: ClassVar[Transmission] = "joint"
  _constants = frozenset({"_ids", "_lo", "_hi"})

  def __init__(self, cfg: DrivenTargetsCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    kind = self.transmission
    self._entity = env.scene[cfg.entity]
    self._owner = f"entity '{cfg.entity}'"
    driven = () if self._entity.actuators is None else self._entity.actuators.driven(kind)
    names: tuple[str, ...] = getattr(self._entity, f"{kind}_names")
    _, self.target_names = match_names(
      cfg.actuators,
      [name for name in names if name in driven],
      what=f"actuated {kind}",
      owner=self._owner,
      preserve_order=cfg.preserve_order,
    )
    self._columns = [names.index(name) for name in self.target_names]
    self._ids = as_index(self._columns, env.device)
    self._constant: dict[str, Any] = {"device": env.device, "dtype": env.sim.dtype}
    self._lo, self._hi = self._bounds(cfg)

  def _per_target(self, values: float | Mapping[str, float], what: str) -> torch.Tensor:
    owner = f"{self._owner}: {what}"
    numbers = match_values_full(values, self.target_names, what=self.transmission, owner=owner)
    if not all(map(math.isfinite, numbers)):
      raise ValueError(f"{owner} must be finite, got {values}")
    return torch.tensor([numbers], **self._constant)

  def _bounds(self, cfg: DrivenTargetsCfg) -> tuple[torch.Tensor | None, torch.Tensor | None]:
    if cfg.clip is None:
      return None, None
    endless = (-float("inf"), float("inf"))
    by_pattern = {".*": cfg.clip} if isinstance(cfg.clip, tuple) else cfg.clip
    for pattern, bounds in by_pattern.items():
      check_bounds(f"clip['{pattern}']", bounds)
    owner = f"{self._owner}: clip"
    bounds = match_values_full(by_pattern, self.target_names, what=self.transmission, owner=owner, default=endless)
    table = torch.tensor([bounds], **self._constant)
    return table[..., 0], table[..., 1]

  @property
  def driven(self) -> frozenset[str]:
    # A tendon may be called like a joint.
    kind = "" if self.transmission == "joint" else f"{self.transmission} "
    return frozenset(f"{self.cfg.entity}/{kind}{name}" for name in self.target_names)

  def clipped(self, target: torch.Tensor) -> torch.Tensor:
    """Set-points within the bounds of `clip`, (num_envs, targets)."""
    return target if self._lo is None else target.clamp(self._lo, self._hi)

  def apply_actions(self) -> None:
    """Nothing: a set-point holds until the next one."""


class DrivenJoints(DrivenTargets):
  """Base of what gives set-points to joints, by their positions and velocities."""

  _constants = frozenset({"_q", "_v"})

  def __init__(self, cfg: DrivenTargetsCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    # The same joints as columns of positions and of velocities; what is actuated has one of each.
    ix = self._entity.indexing
    self._q, self._v = (
      as_index([of[joint][0] for joint in self._columns], env.device) for of in (ix.q_of_joint, ix.v_of_joint)
    )

  @property
  def joint_names(self) -> list[str]:
    """Names of the joints, in the order of the set-points."""
    return self.target_names

  def set_positions(self, target: torch.Tensor) -> None:
    """Set-points (num_envs, joints) as the encoders would read them, so without their bias."""
    bias = self._entity.data.encoder_bias[:, self._q]
    self._entity.set_joint_position_target(target - bias, joint_ids=self._ids)

  def measured_positions(self) -> torch.Tensor:
    """Joint positions as the encoders read them, (num_envs, joints) [rad, m]."""
    return self._entity.data.joint_pos_biased[:, self._q]


class AffineAction(DrivenTargets):
  """Base of actions with one column for each target: the affine map and its constants, (1, targets)."""

  _constants = frozenset({"_scale", "_offset"})

  def __init__(self, cfg: AffineActionCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._scale = self._per_target(cfg.scale, "scale")
    default = self._default_offset()
    if default is not None and getattr(cfg, "use_default_offset", False):
      if cfg.offset is not None:
        raise ValueError(
          f"offset is given, and use_default_offset is on: which one? Set use_default_offset=False to use {cfg.offset}"
        )
      self._offset = default
    else:
      self._offset = self._per_target(0.0 if cfg.offset is None else cfg.offset, "offset")

  def _default_offset(self) -> torch.Tensor | None:
    """What `use_default_offset` means for this action, (1, targets); None if nothing."""
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
    """Set-points of raw actions, (num_envs, targets)."""
    return self.clipped(torch.addcmul(self._offset, actions.to(self._scale.dtype), self._scale))


class JointPositionAction(AffineAction, DrivenJoints):
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


class RelativeJointPositionAction(AffineAction, DrivenJoints):
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
    self._open = self.clipped(self._per_target(cfg.open, "open"))
    self._close = self.clipped(self._per_target(cfg.close, "close"))

  @property
  def action_dim(self) -> int:
    return 1

  def process_actions(self, actions: torch.Tensor) -> None:
    self.set_positions(torch.where(actions < 0.0, self._close, self._open))


class JointVelocityAction(AffineAction, DrivenJoints):
  """See `JointVelocityActionCfg`."""

  def _default_offset(self) -> torch.Tensor:
    return self._entity.data.default_joint_vel[:, self._v].clone()

  def process_actions(self, actions: torch.Tensor) -> None:
    self._entity.set_joint_velocity_target(self.target(actions), joint_ids=self._ids)


class JointEffortAction(AffineAction, DrivenJoints):
  """See `JointEffortActionCfg`."""

  def process_actions(self, actions: torch.Tensor) -> None:
    self._entity.set_joint_effort_target(self.target(actions), joint_ids=self._ids)


class TendonLengthAction(AffineAction):
  """See `TendonLengthActionCfg`."""

  transmission = "tendon"

  def process_actions(self, actions: torch.Tensor) -> None:
    self._entity.set_tendon_len_target(self.target(actions), tendon_ids=self._ids)


class TendonVelocityAction(AffineAction):
  """See `TendonVelocityActionCfg`."""

  transmission = "tendon"

  def process_actions(self, actions: torch.Tensor) -> None:
    self._entity.set_tendon_vel_target(self.target(actions), tendon_ids=self._ids)


class TendonEffortAction(AffineAction):
  """See `TendonEffortActionCfg`."""

  transmission = "tendon"

  def process_actions(self, actions: torch.Tensor) -> None:
    self._entity.set_tendon_effort_target(self.target(actions), tendon_ids=self._ids)


class SiteEffortAction(AffineAction):
  """See `SiteEffortActionCfg`."""

  transmission = "site"

  def process_actions(self, actions: torch.Tensor) -> None:
    self._entity.set_site_effort_target(self.target(actions), site_ids=self._ids)
