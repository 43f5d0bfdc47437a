"""Terminations that any task can use."""

import math
from typing import TYPE_CHECKING

import torch
from mjlab_managers import SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv

_ROBOT = SceneEntityCfg("robot")


def time_out(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Whether the episode has lasted its full length, (num_envs,)."""
  return env.episode_length_buf >= env.max_episode_length


def bad_orientation(env: "ManagerBasedRlEnv", *, limit_angle: float, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Whether the root's z axis leans more than `limit_angle` [rad] from upright, (num_envs,)."""
  # Compared through its cosine: cos falls as the angle grows, and needs no clamp against rounding.
  return -env.scene[asset.name].data.projected_gravity_b[:, 2] < math.cos(limit_angle)


def root_height_below_minimum(
  env: "ManagerBasedRlEnv", *, minimum_height: float, asset: SceneEntityCfg = _ROBOT
) -> torch.Tensor:
  """Whether the root is lower than `minimum_height` above the world's origin [m], (num_envs,)."""
  height = env.scene[asset.name].data.root_link_pos_w[:, 2] - env.scene.env_origins[:, 2]
  return height < minimum_height


def nan_detection(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Whether position, velocity or acceleration of the world is not finite, (num_envs,)."""
  data = env.sim.data
  # A sum over infinities or NaNs of any kind is not finite.
  total = data.qpos.abs().sum(-1) + data.qvel.abs().sum(-1) + data.qacc.abs().sum(-1)
  return ~torch.isfinite(total)
