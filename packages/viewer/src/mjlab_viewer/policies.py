"""Policies that act in a playback."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import torch

Policy: TypeAlias = Callable[[Any], torch.Tensor]
"""Actions for observations. A recurrent policy also has `reset(dones)`, with a bool mask (num_envs,) or None."""


class ZeroPolicy:
  """Zero actions, (num_envs, num_actions)."""

  def __init__(self, num_envs: int, num_actions: int, device: torch.device) -> None:
    self._actions = torch.zeros(num_envs, num_actions, device=device)

  def __call__(self, observations: object) -> torch.Tensor:
    del observations
    return self._actions


class RandomPolicy(ZeroPolicy):
  """Uniform actions in [-1, 1), (num_envs, num_actions)."""

  def __call__(self, observations: object) -> torch.Tensor:
    return super().__call__(observations).uniform_(-1.0, 1.0)


@dataclass(kw_only=True, frozen=True)
class CheckpointList:
  """Checkpoints of a run that a user can choose from."""

  names: Callable[[], Sequence[str]]
  """Return the present names, oldest first; called again for each refresh."""
  load: Callable[[str], Policy]
  """Return the policy of a name, or raise an error that says why it cannot be loaded."""
  loaded: str
  """Name of the first policy; it need not be one of `names`."""
