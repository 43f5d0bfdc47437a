"""Observations of tracking. Rotations are the first two columns of their matrix, row by row: six numbers."""

from typing import TYPE_CHECKING

import torch
from mjlab_core import matrix_from_quat, require, subtract_frames
from mjlab_envs.mdp.readings import pose_of
from mjlab_managers import Reading, TermSource, sourced

from mjlab_tracking.mdp.command import MotionCommand

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def _anchor_pos_source(env: "ManagerBasedRlEnv", *, command: str) -> TermSource:
  position, orientation, target_position, target_orientation = _anchor_readings(env, command)
  return TermSource(
    readings=(position, orientation, target_position, target_orientation),
    compute=lambda *poses: subtract_frames(*poses)[0],
  )


def _anchor_ori_source(env: "ManagerBasedRlEnv", *, command: str) -> TermSource:
  _, orientation, _, target_orientation = _anchor_readings(env, command)
  return TermSource(
    readings=(orientation, target_orientation),
    compute=lambda quat, target: _six(subtract_frames(quat[:, 1:], quat, target[:, 1:], target)[1]),
  )


def _anchor_readings(env: "ManagerBasedRlEnv", command: str) -> tuple[Reading, Reading, Reading, Reading]:
  """Return position and orientation of the robot's anchor, then those of the clip's."""
  term = motion(env, command)
  body = term.cfg.anchor_body
  of = ("body", term.robot.prefix + body)
  return (
    pose_of(f"estimate/{body}/position", lambda: term.robot_anchor_pos_w, quantity="position", of=of),
    pose_of(f"imu/{body}/orientation", lambda: term.robot_anchor_quat_w, quantity="orientation", of=of),
    Reading(name="motion/anchor_position", read=lambda: term.anchor_pos_w, unit="m", frame="world"),
    Reading(name="motion/anchor_orientation", read=lambda: term.anchor_quat_w, frame="world"),
  )


@sourced(_anchor_pos_source)
def motion_anchor_pos_b(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the position of the reference's anchor in the frame of the robot's, (num_envs, 3) [m]."""
  return _anchor_b(env, command)[0]


@sourced(_anchor_ori_source)
def motion_anchor_ori_b(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the orientation of the reference's anchor in the frame of the robot's, (num_envs, 6)."""
  return _six(_anchor_b(env, command)[1])


def robot_body_pos_b(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the positions of the robot's followed bodies in the frame of its anchor, (num_envs, 3 bodies) [m]."""
  return _bodies_b(env, command)[0].flatten(1)


def robot_body_ori_b(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the orientations of the robot's followed bodies in the frame of its anchor, (num_envs, 6 bodies)."""
  return _six(_bodies_b(env, command)[1]).flatten(1)


def motion(env: "ManagerBasedRlEnv", command: str) -> MotionCommand:
  """Return the motion command of that name.

  Raises:
    MjlabError: The command is not a `MotionCommand`.
  """
  return require(env.command_manager.get_term(command), MotionCommand, f"command '{command}' is not a MotionCommand")


def _anchor_b(env: "ManagerBasedRlEnv", command: str) -> tuple[torch.Tensor, torch.Tensor]:
  term = motion(env, command)
  return subtract_frames(term.robot_anchor_pos_w, term.robot_anchor_quat_w, term.anchor_pos_w, term.anchor_quat_w)


def _bodies_b(env: "ManagerBasedRlEnv", command: str) -> tuple[torch.Tensor, torch.Tensor]:
  term = motion(env, command)
  pos, quat = term.robot_anchor_pos_w[:, None], term.robot_anchor_quat_w[:, None]
  return subtract_frames(pos, quat, term.robot_body_pos_w, term.robot_body_quat_w)


def _six(quat: torch.Tensor) -> torch.Tensor:
  return matrix_from_quat(quat)[..., :2].flatten(-2)
