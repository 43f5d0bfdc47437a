"""Terminations that any task can use."""

import math
from typing import TYPE_CHECKING

import torch
from mjlab_managers import SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_envs.base_env import ManagerBasedEnv

_ROBOT = SceneEntityCfg("robot")


def time_out(env: "ManagerBasedEnv") -> torch.Tensor:
  """Return True where the episode has reached its full length, (num_envs,)."""
  return env.episode_length_buf >= env.max_episode_length


def bad_orientation(env: "ManagerBasedEnv", *, limit_angle: float, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Return True where the root's z axis leans more than `limit_angle` [rad] from upright, (num_envs,)."""
  # Compared through its cosine: cos falls as the angle grows, and needs no clamp against rounding.
  cosine = limit_angle.cos() if isinstance(limit_angle, torch.Tensor) else math.cos(limit_angle)
  return -env.scene[asset.name].data.projected_gravity_b[:, 2] < cosine


def root_height_below_minimum(
  env: "ManagerBasedEnv", *, minimum_height: float, asset: SceneEntityCfg = _ROBOT
) -> torch.Tensor:
  """Return True where the root is lower than `minimum_height` above the world's origin [m], (num_envs,)."""
  height = env.scene[asset.name].data.root_link_pos_w[:, 2] - env.scene.env_origins[:, 2]
  return height < minimum_height


def nan_detection(env: "ManagerBasedEnv") -> torch.Tensor:
  """Return True where a position, velocity or acceleration is not finite, (num_envs,)."""
  data = env.sim.data
  # A sum over infinities or NaNs of any kind is not finite.
  total = data.qpos.abs().sum(-1) + data.qvel.abs().sum(-1) + data.qacc.abs().sum(-1)
  return ~torch.isfinite(total)
