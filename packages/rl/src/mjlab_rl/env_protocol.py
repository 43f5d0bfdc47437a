"""What the learner needs from an environment."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import torch


class ActionManager(Protocol):
  """The part of the action manager that the learner reads."""

  @property
  def total_action_dim(self) -> int: ...


class RlEnv(Protocol):
  """A batch of worlds that resets its ended episodes inside `step`.

  Every tensor is on `device`. Observations, rewards and flags returned by `step` are fresh tensors: the learner keeps
  references to them until the next step is done. Observations are tensors (num_envs, ...) by group.
  """

  cfg: Any
  """Configuration the environment was built from."""
  num_envs: int
  device: torch.device
  episode_length_buf: torch.Tensor
  """Steps since the last reset, (num_envs,) int64, always the same memory."""

  output_dir: Path | None
  """Folder of the run, set before its first iteration; None where nothing is written."""

  @property
  def max_episode_length(self) -> int:
    """Steps after which an episode is cut."""
    ...

  @property
  def action_manager(self) -> ActionManager: ...

  def reset(self, *, seed: int | None = None) -> tuple[Mapping[str, Any], dict[str, Any]]:
    """Reset all worlds; returns (observations, info)."""
    ...

  def step(
    self, action: torch.Tensor
  ) -> tuple[Mapping[str, Any], torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
    """Advance all worlds; returns (observations by group, reward, terminated, truncated, extras)."""
    ...

  def get_observations(self) -> Mapping[str, Any]:
    """Observations of the present state by group; asking twice changes nothing."""
    ...

  def drain_log(self) -> dict[str, float]:
    """Read and clear the means accumulated since the last call; one host transfer."""
    ...

  def state_dict(self) -> dict[str, Any]:
    """Everything the future depends on: physics, counters, managers, random generators."""
    ...

  def load_state_dict(self, state: dict[str, Any]) -> None:
    """Go on from a `state_dict` of an environment with as many worlds."""
    ...

  def load_progress(self, state: dict[str, Any]) -> None:
    """Take from a `state_dict` only how far training had come; the number of worlds does not matter."""
    ...

  def close(self) -> None: ...
