"""Metrics that any task can use."""

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv


def mean_action_acc(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Return mean_j |a_t - 2 a_{t-1} + a_{t-2}| of raw actions, (num_envs,)."""
  manager = env.action_manager
  return (manager.action - 2.0 * manager.prev_action + manager.prev_prev_action).abs().mean(-1)
