"""Distances of the robot from the reference, for rewards, terminations, metrics and evaluation."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Literal, get_args

import torch
from mjlab_core import check_name, quat_error_magnitude

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


def body_distance(term: MotionCommand) -> torch.Tensor:
  """Return the distance of each followed body from the reference laid over the robot, (num_envs, bodies) [m]."""
  return norm(term.body_pos_relative_w - term.robot_body_pos_w)


def body_angle(term: MotionCommand) -> torch.Tensor:
  """Return the angle of each followed body to the reference laid over the robot, (num_envs, bodies) [rad]."""
  return quat_error_magnitude(term.body_quat_relative_w, term.robot_body_quat_w)


def body_speed_error(term: MotionCommand) -> torch.Tensor:
  """Return the error of each followed body's linear velocity in the world, (num_envs, bodies) [m/s]."""
  return norm(term.body_lin_vel_w - term.robot_body_lin_vel_w)


def body_spin_error(term: MotionCommand) -> torch.Tensor:
  """Return the error of each followed body's angular velocity in the world, (num_envs, bodies) [rad/s]."""
  return norm(term.body_ang_vel_w - term.robot_body_ang_vel_w)


_ERRORS: dict[Quantity, Callable[[MotionCommand], torch.Tensor]] = {
  "anchor_pos": lambda term: norm(term.anchor_pos_w - term.robot_anchor_pos_w),
  "anchor_rot": lambda term: quat_error_magnitude(term.anchor_quat_w, term.robot_anchor_quat_w),
  "anchor_lin_vel": lambda term: body_speed_error(term)[:, term.anchor],
  "anchor_ang_vel": lambda term: body_spin_error(term)[:, term.anchor],
  "body_pos": body_distance,
  "body_rot": body_angle,
  "body_lin_vel": body_speed_error,
  "body_ang_vel": body_spin_error,
  "joint_pos": lambda term: norm(term.joint_pos - term.robot.data.joint_pos),
  "joint_vel": lambda term: norm(term.joint_vel - term.robot.data.joint_vel),
}


def motion_error(env: "ManagerBasedRlEnv", *, command: str, quantity: Quantity) -> torch.Tensor:
  """Return one error of the robot, (num_envs,) [m, rad, m/s or rad/s]: of bodies the mean, of joints the norm.

  Anchors and all velocities are compared in the world, bodies with the reference laid over the robot.

  Raises:
    UnknownNameError: The quantity does not exist.
  """
  check_name("quantity", quantity, QUANTITIES)
  error = _ERRORS[quantity](motion(env, command))
  return error if error.dim() == 1 else error.mean(-1)


def mpkpe(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the mean distance of the followed bodies from the reference in the world, (num_envs,) [m]."""
  term = motion(env, command)
  return norm(term.body_pos_w - term.robot_body_pos_w).mean(-1)


def root_relative_mpkpe(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the same with the reference moved onto the robot's anchor and turned to its heading, (num_envs,) [m]."""
  term = motion(env, command)
  difference = term.body_pos_relative_w - term.robot_body_pos_w
  height = difference[..., 2:] + (term.robot_anchor_pos_w - term.anchor_pos_w)[:, None, 2:]
  return norm(torch.cat((difference[..., :2], height), -1)).mean(-1)


def body_position_error(env: "ManagerBasedRlEnv", *, command: str, bodies: tuple[str, ...]) -> torch.Tensor:
  """Return the mean distance of some bodies from the reference laid over the robot, (num_envs,) [m]."""
  term = motion(env, command)
  return term.of_bodies(body_distance(term), bodies).mean(-1)


def body_orientation_error(env: "ManagerBasedRlEnv", *, command: str, bodies: tuple[str, ...]) -> torch.Tensor:
  """Return the mean angle of some bodies to the reference laid over the robot, (num_envs,) [rad]."""
  term = motion(env, command)
  return term.of_bodies(body_angle(term), bodies).mean(-1)


def norm(difference: torch.Tensor) -> torch.Tensor:
  """Return the Euclidean norm over the last axis."""
  return torch.linalg.vector_norm(difference, dim=-1)
