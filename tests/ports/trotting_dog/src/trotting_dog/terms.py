"""Rewards of a trot by the clock, and what a policy reads from the clock."""

import math
from typing import TYPE_CHECKING

import torch
from mjlab_managers import SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

OFFSETS = (0.0, 0.5, 0.5, 0.0)
"""Share of the period by which each foot is late: diagonal feet move together."""


def phase(env: "ManagerBasedRlEnv", period: float) -> torch.Tensor:
  """Return the share of the period that has passed, (num_envs,) in [0, 1)."""
  return (env.episode_length_buf * env.step_dt / period) % 1.0


def clock(env: "ManagerBasedRlEnv", *, period: float) -> torch.Tensor:
  """Return sine and cosine of the clock, (num_envs, 2)."""
  angle = 2.0 * math.pi * phase(env, period)
  return torch.stack((angle.sin(), angle.cos()), -1)


def gait(env: "ManagerBasedRlEnv", *, sensor: str, period: float, stance: float) -> torch.Tensor:
  """Return the share of feet whose contact is that of the clock, (num_envs,)."""
  touches = env.scene[sensor].data.found > 0
  late = torch.stack([(phase(env, period) + offset) % 1.0 for offset in OFFSETS], -1)
  return ((late < stance) == touches).float().mean(-1)


def velocity_error(env: "ManagerBasedRlEnv", *, command: str, scale: float) -> torch.Tensor:
  """Return exp(-|v_xy - u_xy|^2 / scale), (num_envs,)."""
  velocity = env.scene["robot"].data.root_link_lin_vel_b[:, :2]
  return torch.exp(-(velocity - env.command_manager.get_command(command)[:, :2]).square().sum(-1) / scale)


def height_error(env: "ManagerBasedRlEnv", *, target: float) -> torch.Tensor:
  """Return the squared error of the root's height, (num_envs,) [m^2]."""
  height = env.scene["robot"].data.root_link_pos_w[:, 2] - env.scene.env_origins[:, 2]
  return (height - target).square()


def vertical_speed(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Return the squared vertical speed of the root, (num_envs,) [m^2/s^2]."""
  return env.scene["robot"].data.root_link_lin_vel_b[:, 2].square()


def hip_deviation(env: "ManagerBasedRlEnv", *, hips: SceneEntityCfg) -> torch.Tensor:
  """Return the summed deviation of hips from the default pose, (num_envs,) [rad]."""
  data = env.scene[hips.name].data
  return (data.joint_pos - data.default_joint_pos)[:, hips.joint_ids].abs().sum(-1)
