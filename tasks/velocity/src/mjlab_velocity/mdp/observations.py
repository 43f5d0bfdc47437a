"""Observations of the feet of legged robots."""

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def foot_height(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return the height of each foot above the ground, (num_envs, feet) [m]."""
  return env.scene[sensor].data.heights


def foot_air_time(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return the time that each foot has been in the air, (num_envs, feet) [s]."""
  return env.scene[sensor].data.current_air_time


def foot_contact(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return 1 for each foot on the ground, (num_envs, feet)."""
  return (env.scene[sensor].data.found > 0).float()


def foot_contact_forces(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return sign(f) log(1 + |f|) of the net contact force of each foot, world frame, (num_envs, 3 feet) [log N]."""
  force = env.scene[sensor].data.force.flatten(1)
  return torch.sign(force) * torch.log1p(force.abs())
