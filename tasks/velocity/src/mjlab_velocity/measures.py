"""Measurements of an evaluation in each step: errors, effort and impacts."""

from typing import TYPE_CHECKING

import torch

from mjlab_velocity.mdp.rewards import landed

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def linear_error_squared(env: "ManagerBasedRlEnv", *, command: str, entity: str) -> torch.Tensor:
  """Return |v_xy - u_xy|^2 in the root frame, (num_envs,) [m^2/s^2]."""
  velocity = env.scene[entity].data.root_link_lin_vel_b
  return (velocity[:, :2] - env.command_manager.get_command(command)[:, :2]).square().sum(-1)


def turning_error_squared(env: "ManagerBasedRlEnv", *, command: str, entity: str) -> torch.Tensor:
  """Return (w_z - u_z)^2 in the root frame, (num_envs,) [rad^2/s^2]."""
  velocity = env.scene[entity].data.root_link_ang_vel_b
  return (velocity[:, 2] - env.command_manager.get_command(command)[:, 2]).square()


def mechanical_power(env: "ManagerBasedRlEnv", *, entity: str) -> torch.Tensor:
  """Return the sum over joints of |torque x velocity|, (num_envs,) [W]."""
  data = env.scene[entity].data
  return (data.qfrc_actuator * data.joint_vel).abs().sum(-1)


def horizontal_speed(env: "ManagerBasedRlEnv", *, entity: str) -> torch.Tensor:
  """Return the horizontal speed of the root, (num_envs,) [m/s]."""
  return torch.linalg.vector_norm(env.scene[entity].data.root_link_lin_vel_w[:, :2], dim=-1)


def torque_squared(env: "ManagerBasedRlEnv", *, entity: str) -> torch.Tensor:
  """Return the mean over joints of the squared torque, (num_envs,) [N^2 m^2]."""
  return env.scene[entity].data.qfrc_actuator.square().mean(-1)


def action_change_squared(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Return the mean over actions of their squared change in this step, (num_envs,)."""
  actions = env.action_manager
  return (actions.action - actions.prev_action).square().mean(-1)


def landings(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return the number of feet that just landed, (num_envs,)."""
  return landed(env, sensor).sum(-1, dtype=torch.float32)


def landing_force(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return the contact force of feet that just landed, summed over feet, (num_envs,) [N]."""
  force = torch.linalg.vector_norm(env.scene[sensor].data.force, dim=-1)
  return (force * landed(env, sensor)).sum(-1)
