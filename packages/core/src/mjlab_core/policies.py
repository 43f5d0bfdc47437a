"""Form of policies, and those that need no network."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import torch

Policy: TypeAlias = Callable[[Any], torch.Tensor]
"""Function from observations by group to actions, (num_envs, num_actions).

A recurrent one also has `reset(dones)`, with a bool mask (num_envs,) or None.
"""


class ZeroPolicy:
  """Zero actions, (num_envs, num_actions)."""

  def __init__(self, num_envs: int, num_actions: int, device: torch.device) -> None:
    self._actions = torch.zeros(num_envs, num_actions, device=device)

  def __call__(self, observations: object) -> torch.Tensor:
    del observations
    return self._actions


class RandomPolicy(ZeroPolicy):
  """Uniform actions in [-1, 1) from a separate generator, (num_envs, num_actions)."""

  def __init__(self, num_envs: int, num_actions: int, device: torch.device) -> None:
    super().__init__(num_envs, num_actions, device)
    self._generator = torch.Generator(device)

  def __call__(self, observations: object) -> torch.Tensor:
    return super().__call__(observations).uniform_(-1.0, 1.0, generator=self._generator)


class FinitePolicy:
  """Policy that counts actions with NaN or infinity, which an environment replaces by zero.

  Args:
    policy: The policy.
    on_first: Called once when the first such action is seen. Each call then waits for the device.
  """

  def __init__(self, policy: Any, on_first: Callable[[], None] | None = None) -> None:
    self._policy, self._on_first = policy, on_first
    self._count: int | torch.Tensor = 0

  @property
  def num_broken(self) -> int:
    """Number of actions, one per world and step, that were not finite."""
    return int(self._count)

  def __call__(self, observations: Mapping[str, Any]) -> torch.Tensor:
    """Return the actions of the policy, (num_envs, num_actions)."""
    actions: torch.Tensor = self._policy(observations)
    self._count = self._count + (~actions.isfinite()).any(-1).sum()
    if self._on_first is not None and self.num_broken:
      self._on_first()
      self._on_first = None
    return actions

  def reset(self, dones: torch.Tensor | None) -> None:
    """Reset the policy in these worlds, bool (num_envs,); None: in all."""
    if (reset := getattr(self._policy, "reset", None)) is not None:
      reset(dones)
