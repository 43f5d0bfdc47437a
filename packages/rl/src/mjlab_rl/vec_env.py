"""Adapter from an environment to rsl-rl's `VecEnv`."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from mjlab_core.names import check_name
from rsl_rl.env import VecEnv
from tensordict import TensorDict

from mjlab_rl.env_protocol import RlEnv


class RslRlVecEnvWrapper(VecEnv):
  """rsl-rl's `VecEnv` of an `RlEnv`. It resets the environment on construction and never waits for the GPU.

  Args:
    env: The environment.
    clip_actions: Limit of the absolute value of every action, None for no limit.
  """

  def __init__(self, env: RlEnv, *, clip_actions: float | None = None):
    self.unwrapped = env
    """The environment itself."""
    self.num_envs = env.num_envs
    self.num_actions = env.action_manager.total_action_dim
    self.max_episode_length = env.max_episode_length
    self.device = env.device
    self.cfg = env.cfg
    self.clip_actions = clip_actions
    self.groups: frozenset[str] | None = None
    """Observation groups to pass on, which a rollout stores; None: all."""
    # The time limit of a finite-horizon episode is its true end, without bootstrapping.
    self._is_finite_horizon = bool(getattr(env.cfg, "is_finite_horizon", False))
    env.reset()

  @property
  def episode_length_buf(self) -> torch.Tensor:
    """Steps since the last reset, (num_envs,) int64; assigning copies into the environment's memory."""
    return self.unwrapped.episode_length_buf

  @episode_length_buf.setter
  def episode_length_buf(  # pyright: ignore[reportIncompatibleVariableOverride]
    self, value: torch.Tensor
  ) -> None:
    self.unwrapped.episode_length_buf.copy_(value)

  def select(self, obs_groups: Mapping[str, Sequence[str]]) -> dict[str, list[list[int]]]:
    """Pass on only the observation groups of some networks; return the shapes of each network's, for one world.

    Raises:
      UnknownNameError: The environment has no such group.
    """
    seen = self.unwrapped.get_observations()
    for network, groups in obs_groups.items():
      for group in groups:
        check_name("observation group", group, seen, f"agent.obs_groups['{network}']")
    # A rollout stores all groups that it gets.
    self.groups = frozenset(group for groups in obs_groups.values() for group in groups)
    return {network: [list(seen[group].shape[1:]) for group in groups] for network, groups in obs_groups.items()}

  def get_observations(self) -> TensorDict:
    """Return the current observations, batch size (num_envs,)."""
    return self._batch(self.unwrapped.get_observations())

  def reset(self) -> tuple[TensorDict, dict[str, Any]]:
    """Reset all worlds; return (observations, info)."""
    observations, info = self.unwrapped.reset()
    return self._batch(observations), info

  def close(self) -> None:
    """Close the environment."""
    self.unwrapped.close()

  def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
    """Advance all worlds by one step.

    Args:
      actions: (num_envs, num_actions) float32.

    Returns:
      Observations (batch size (num_envs,)), rewards (num_envs,), dones (num_envs,) int64 and the environment's extras
      with `time_outs` (num_envs,) bool: truncated and not terminated.
    """
    if self.clip_actions is not None:
      actions = actions.clamp(-self.clip_actions, self.clip_actions)
    observations, reward, terminated, truncated, extras = self.unwrapped.step(actions)
    dones = (terminated | truncated).to(torch.int64)
    extras = dict(extras)
    if not self._is_finite_horizon:
      extras["time_outs"] = truncated & ~terminated
    return self._batch(observations), reward, dones, extras

  def drain_log(self) -> dict[str, float]:
    """Return the means of the environment's log values since the last call."""
    return self.unwrapped.drain_log()

  def _batch(self, observations: Mapping[str, Any]) -> TensorDict:
    handed_on = {name: seen for name, seen in observations.items() if self.groups is None or name in self.groups}
    return TensorDict(handed_on, batch_size=[self.num_envs])
