"""Joint actions: from the policy's output to set-points of joints."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from mjlab_core.names import match_names, match_values_full
from mjlab_core.sampling import check_range
from mjlab_managers import ActionTerm, ActionTermCfg
from mjlab_scene.indexing import as_index

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv


@dataclass(kw_only=True)
class JointActionCfg(ActionTermCfg):
  """Base of joint actions: set-point = clip(scale * action + offset)."""

  entity: str = "robot"
  actuators: str | tuple[str, ...] = ".*"
  """Patterns of the joints that are driven, among those that have an actuator."""
  scale: float | dict[str, float] = 1.0
  """One factor, or one per joint by pattern."""
  offset: float | dict[str, float] | None = None
  """One offset, or one per joint by pattern; None takes `use_default_offset`'s."""
  clip: tuple[float, float] | dict[str, tuple[float, float]] | None = None
  """Bounds of the set-point, or bounds by pattern; joints left out are not bounded."""
  preserve_order: bool = False
  """Order of the action's columns: of the patterns, or of the model."""


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


class JointAction(ActionTerm):
  """Base of joint actions: the affine map and its constants, (1, joints)."""

  _constants = frozenset({"_ids", "_q", "_v", "_scale", "_offset", "_lo", "_hi"})

  def __init__(self, cfg: JointActionCfg, env: "ManagerBasedRlEnv") -> None:
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
    constant: dict[str, Any] = {"device": env.device, "dtype": env.sim.dtype}

    def per_joint(values: float | Mapping[str, float], what: str) -> torch.Tensor:
      numbers = match_values_full(values, self.joint_names, what="joint", owner=f"{owner}: {what}")
      return torch.tensor([numbers], **constant)

    self._scale = per_joint(cfg.scale, "scale")
    default = self._default_offset()
    if default is not None and getattr(cfg, "use_default_offset", False):
      if cfg.offset is not None:
        raise ValueError(
          f"offset is given, and use_default_offset is on: which one? Set use_default_offset=False to use {cfg.offset}"
        )
      self._offset = default
    else:
      self._offset = per_joint(0.0 if cfg.offset is None else cfg.offset, "offset")
    self._lo, self._hi = self._bounds(cfg, owner, constant)

  def _bounds(
    self, cfg: JointActionCfg, owner: str, constant: dict[str, Any]
  ) -> tuple[torch.Tensor | None, torch.Tensor | None]:
    if cfg.clip is None:
      return None, None
    endless = (-float("inf"), float("inf"))
    by_pattern = {".*": cfg.clip} if isinstance(cfg.clip, tuple) else cfg.clip
    for pattern, bounds in by_pattern.items():
      check_range(f"clip['{pattern}']", *bounds)
    bounds = match_values_full(by_pattern, self.joint_names, what="joint", owner=f"{owner}: clip", default=endless)
    table = torch.tensor([bounds], **constant)
    return table[..., 0], table[..., 1]

  def _default_offset(self) -> torch.Tensor | None:
    """What `use_default_offset` means for this action, (1, joints); None if nothing."""
    return None

  @property
  def action_dim(self) -> int:
    return len(self.joint_names)

  @property
  def driven(self) -> frozenset[str]:
    return frozenset(f"{self.cfg.entity}/{name}" for name in self.joint_names)

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
    value = torch.addcmul(self._offset, actions.to(self._scale.dtype), self._scale)
    return value if self._lo is None else value.clamp(self._lo, self._hi)

  def apply_actions(self) -> None:
    """Nothing: a set-point holds until the next one."""


class JointPositionAction(JointAction):
  """See `JointPositionActionCfg`."""

  def _default_offset(self) -> torch.Tensor:
    return self._entity.data.default_joint_pos[:, self._q].clone()

  def process_actions(self, actions: torch.Tensor) -> None:
    bias = self._entity.data.encoder_bias[:, self._q]
    self._entity.set_joint_position_target(self.target(actions) - bias, joint_ids=self._ids)


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
