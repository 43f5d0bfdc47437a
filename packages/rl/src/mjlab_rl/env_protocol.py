"""Protocol of environments."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import torch


class RlEnv(Protocol):
  """Batch of worlds that resets ended episodes inside `step`.

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
  """Folder of the run, set before the first iteration; None if nothing is written."""

  @property
  def max_episode_length(self) -> int:
    """Steps after which an episode is cut."""
    ...

  @property
  def action_manager(self) -> Any:
    """Manager with `total_action_dim`, the width of actions."""
    ...

  def reset(self, *, seed: int | None = None) -> tuple[Mapping[str, Any], dict[str, Any]]:
    """Reset all worlds; return (observations, info)."""
    ...

  def step(
    self, action: torch.Tensor
  ) -> tuple[Mapping[str, Any], torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
    """Advance all worlds; return (observations by group, reward, terminated, truncated, extras)."""
    ...

  def get_observations(self) -> Mapping[str, Any]:
    """Return the current observations by group; a second call returns the same."""
    ...

  def drain_log(self) -> dict[str, float]:
    """Read and clear the means accumulated since the last call; one host transfer."""
    ...

  def state_dict(self) -> dict[str, Any]:
    """Return the complete state: physics, counters, managers, random generators."""
    ...

  def load_state_dict(self, state: dict[str, Any]) -> None:
    """Restore a `state_dict` of an environment with the same number of worlds."""
    ...

  def load_progress(self, state: dict[str, Any]) -> None:
    """Restore only the progress of training from a `state_dict`, of any number of worlds."""
    ...

  def close(self) -> None: ...
