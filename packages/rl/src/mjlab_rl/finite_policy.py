"""Check that a policy's actions are finite."""

from collections.abc import Callable, Mapping
from typing import Any

import torch


class FinitePolicy:
  """Policy that counts actions with NaN or infinity, which an environment replaces by zero.

  Args:
    policy: The policy.
    on_first: Called once when the first such action is seen. Each call then waits for the device.
  """

  def __init__(self, policy: Any, on_first: Callable[[], None] | None = None) -> None:
    self._policy, self._on_first = policy, on_first
    self._count: torch.Tensor | None = None

  @property
  def num_broken(self) -> int:
    """Number of actions, one per world and step, of which a part was not finite."""
    return 0 if self._count is None else int(self._count)

  def __call__(self, observations: Mapping[str, Any]) -> torch.Tensor:
    """Return the actions of the policy, (num_envs, num_actions)."""
    actions: torch.Tensor = self._policy(observations)
    broken = (~actions.isfinite()).any(-1).sum()
    self._count = broken if self._count is None else self._count + broken
    if self._on_first is not None and self.num_broken:
      self._on_first()
      self._on_first = None
    return actions

  def reset(self, dones: torch.Tensor | None) -> None:
    """Reset the policy in these worlds, bool (num_envs,); None: in all."""
    if (reset := getattr(self._policy, "reset", None)) is not None:
      reset(dones)
