"""Bases of actions that set targets of joints, tendons or sites."""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import torch
from mjlab_actuators import Transmission
from mjlab_core import Bounds, as_index, match_names, match_values_full
from mjlab_managers import ActionTargets, ActionTerm, ActionTermCfg
from mjlab_scene import Quantity

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv


@dataclass(kw_only=True)
class DrivenTargetsCfg(ActionTermCfg):
  """Base of actions that set targets of joints, tendons or sites."""

  entity: str = "robot"
  actuators: str | tuple[str, ...] = ".*"
  """Patterns of the joints, tendons or sites, among those that have an actuator."""
  clip: Bounds | dict[str, Bounds] | None = None
  """Bounds of the targets, or bounds by pattern; those that no pattern names are not bounded."""
  preserve_order: bool = False
  """True: columns in the order of the patterns; False: in the order of the model."""

  action: ClassVar[type["DrivenTargets"]]
  """Class of the term."""
  transmission: ClassVar[Transmission] = "joint"
  """Kind of the targets."""
  quantity: ClassVar[Quantity] = "position"
  """Quantity of the targets that the action sets."""

  def build(self, env: Any) -> "DrivenTargets":
    return self.action(self, env)


class DrivenTargets(ActionTerm):
  """Base of actions that set targets of joints, tendons or sites, with the selection and bounds of the targets."""

  def __init__(self, cfg: DrivenTargetsCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self.transmission, self.quantity = cfg.transmission, cfg.quantity
    kind = self.transmission
    self._entity = env.scene[cfg.entity]
    self._owner = f"entity '{cfg.entity}'"
    driven = self._entity.actuators.driven(kind)
    names: tuple[str, ...] = getattr(self._entity, f"{kind}_names")
    _, self.target_names = match_names(
      cfg.actuators,
      [name for name in names if name in driven],
      what=f"actuated {kind}",
      owner=self._owner,
      preserve_order=cfg.preserve_order,
    )
    self._ids = [names.index(name) for name in self.target_names]
    self._target = self._entity.target_view(kind, self.quantity, self._ids)
    self._lo = self._hi = None
    if cfg.clip is not None:
      bounds = {".*": cfg.clip} if isinstance(cfg.clip, tuple) else cfg.clip
      self._lo, self._hi = self._per_target(bounds, "clip", default=(-torch.inf, torch.inf)).unbind(-1)
    if kind == "joint":
      # The same joints as columns of positions and of velocities; an actuated joint has one of each.
      ix = self._entity.indexing
      self._q, self._v = (
        as_index([of[joint][0] for joint in self._ids], env.device) for of in (ix.q_of_joint, ix.v_of_joint)
      )
    self._has_bias = (kind, self.quantity) == ("joint", "position")

  def _per_target(self, values: Any, what: str, **default: Any) -> torch.Tensor:
    """Return values by pattern, or one for all, as a row, (1, targets, ...)."""
    owner = f"{self._owner}: {what}"
    row = match_values_full(values, self.target_names, what=self.transmission, owner=owner, **default)
    return torch.tensor([row], device=self.device, dtype=self.env.sim.dtype)

  @property
  def driven(self) -> frozenset[str]:
    # A tendon may have the name of a joint.
    kind = "" if self.transmission == "joint" else f"{self.transmission} "
    return frozenset(f"{self.cfg.entity}/{kind}{name}" for name in self.target_names)

  def clipped(self, target: torch.Tensor) -> torch.Tensor:
    """Return targets within the bounds of `clip`, (num_envs, targets)."""
    return target if self._lo is None else target.clamp(self._lo, self._hi)

  def set_targets(self, target: torch.Tensor) -> None:
    """Set targets (num_envs, targets); positions of joints as the encoders would read them, so without their bias."""
    self._target.write(target - self._entity.data.encoder_bias[:, self._q] if self._has_bias else target)

  def measured_positions(self) -> torch.Tensor:
    """Return joint positions as the encoders read them, (num_envs, joints) [rad, m]."""
    return self._entity.data.joint_pos_biased[:, self._q]

  # Export of policies

  def _on_cpu(self) -> Self:
    """Return a copy with its constants in float32 on the CPU, whose computations can be exported."""
    twin = copy.copy(self)
    tensors = {name: value for name, value in vars(self).items() if isinstance(value, torch.Tensor)}
    vars(twin).update({name: value[:1].cpu().float() for name, value in tensors.items()})
    return twin

  def _export(self, compute: Callable[..., torch.Tensor], **memory: Any) -> ActionTargets:
    """Return the computation of targets outside the simulation; `memory` as for `ActionTargets`."""
    return ActionTargets(quantity=self.quantity, joints=tuple(self.target_names), compute=compute, **memory)
