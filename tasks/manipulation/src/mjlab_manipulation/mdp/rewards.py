"""Rewards of lifting. `hand` selects one site."""

from typing import TYPE_CHECKING, cast

import torch
from mjlab_managers import SceneEntityCfg

from mjlab_manipulation.mdp.command import LiftCommand

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def lift(
  env: "ManagerBasedRlEnv", *, command: str, reaching_std: float, bringing_std: float, hand: SceneEntityCfg
) -> torch.Tensor:
  """Return r (1 + b), (num_envs,), for reaching the object and bringing it to its goal.

  r = exp(-|hand to object|^2 / reaching_std^2), b = exp(-|object to goal|^2 / bringing_std^2).
  """
  term = lift_command(env, command)
  reaching = torch.exp(-hand_distance(env, command=command, hand=hand).square() / reaching_std**2)
  return reaching * (1.0 + torch.exp(-term.distance.square() / bringing_std**2))


def lift_precise(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """Return exp(-|object to goal|^2 / std^2), (num_envs,)."""
  return torch.exp(-lift_command(env, command).distance.square() / std**2)


def joint_vel_hinge(env: "ManagerBasedRlEnv", *, max_vel: float, asset: SceneEntityCfg) -> torch.Tensor:
  """Return sum_j max(|qd_j| - max_vel, 0)^2 over the selected joints, (num_envs,) [rad^2/s^2]."""
  speed = env.scene[asset.name].data.joint_vel[:, asset.joint_vel_ids].abs()
  return (speed - max_vel).clamp(min=0.0).square().sum(-1)


def hand_distance(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> torch.Tensor:
  """Return the distance of the hand from the centre of the object, (num_envs,) [m]."""
  place = env.scene[hand.name].data.site_pos_w[:, hand.site_ids].squeeze(1)
  return torch.linalg.vector_norm(lift_command(env, command).object_pos_w - place, dim=-1)


def lift_command(env: "ManagerBasedRlEnv", name: str) -> LiftCommand:
  """Return the lift command of that name."""
  return cast("LiftCommand", env.command_manager.get_term(name))
