"""How far the robot is from the reference: what rewards, terminations and metrics are made of."""

from typing import TYPE_CHECKING, Literal, get_args

import torch
from mjlab_core.names import unknown
from mjlab_core.rotations import quat_error_magnitude

from mjlab_tracking.mdp.command import MotionCommand
from mjlab_tracking.mdp.observations import motion

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

Quantity = Literal[
  "anchor_pos",
  "anchor_rot",
  "anchor_lin_vel",
  "anchor_ang_vel",
  "body_pos",
  "body_rot",
  "body_lin_vel",
  "body_ang_vel",
  "joint_pos",
  "joint_vel",
]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)


def body_distance(command: MotionCommand) -> torch.Tensor:
  """Distance of each followed body from the reference laid over the robot, (num_envs, bodies) [m]."""
  return _norm(command.body_pos_relative_w - command.robot_body_pos_w)


def body_angle(command: MotionCommand) -> torch.Tensor:
  """Angle of each followed body to the reference laid over the robot, (num_envs, bodies) [rad]."""
  return quat_error_magnitude(command.body_quat_relative_w, command.robot_body_quat_w)


def body_speed_error(command: MotionCommand) -> torch.Tensor:
  """Error of each followed body's linear velocity in the world, (num_envs, bodies) [m/s]."""
  return _norm(command.body_lin_vel_w - command.robot_body_lin_vel_w)


def body_spin_error(command: MotionCommand) -> torch.Tensor:
  """Error of each followed body's angular velocity in the world, (num_envs, bodies) [rad/s]."""
  return _norm(command.body_ang_vel_w - command.robot_body_ang_vel_w)


def motion_error(env: "ManagerBasedRlEnv", *, command: str, quantity: Quantity) -> torch.Tensor:
  """One number for how far the robot is from the reference, (num_envs,) [m, rad, m/s or rad/s].

  Of bodies the mean, of joints the Euclidean norm. Anchors and all velocities are compared in the world, bodies with
  the reference laid over the robot.

  Raises:
    ValueError: There is no such quantity.
  """
  term = motion(env, command)
  if quantity == "anchor_pos":
    return _norm(term.anchor_pos_w - term.robot_anchor_pos_w)
  if quantity == "anchor_rot":
    return quat_error_magnitude(term.anchor_quat_w, term.robot_anchor_quat_w)
  if quantity == "anchor_lin_vel":
    return body_speed_error(term)[:, term.anchor]
  if quantity == "anchor_ang_vel":
    return body_spin_error(term)[:, term.anchor]
  if quantity == "body_pos":
    return body_distance(term).mean(-1)
  if quantity == "body_rot":
    return body_angle(term).mean(-1)
  if quantity == "body_lin_vel":
    return body_speed_error(term).mean(-1)
  if quantity == "body_ang_vel":
    return body_spin_error(term).mean(-1)
  if quantity == "joint_pos":
    return _norm(term.joint_pos - term.robot.data.joint_pos)
  if quantity == "joint_vel":
    return _norm(term.joint_vel - term.robot.data.joint_vel)
  raise ValueError(unknown("quantity", quantity, QUANTITIES))


def _norm(difference: torch.Tensor) -> torch.Tensor:
  return torch.linalg.vector_norm(difference, dim=-1)
