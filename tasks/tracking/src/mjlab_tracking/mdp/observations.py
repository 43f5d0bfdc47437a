"""Observations of tracking. Rotations are the first two columns of their matrix, row by row: six numbers."""

from typing import TYPE_CHECKING

import torch
from mjlab_core.frames import subtract_frames
from mjlab_core.rotations import matrix_from_quat

from mjlab_tracking.mdp.command import MotionCommand

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def motion_anchor_pos_b(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Position of the reference's anchor in the frame of the robot's, (num_envs, 3) [m]."""
  return _anchor_b(env, command)[0]


def motion_anchor_ori_b(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Orientation of the reference's anchor in the frame of the robot's, (num_envs, 6)."""
  return _six(_anchor_b(env, command)[1])


def robot_body_pos_b(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Positions of the robot's followed bodies in the frame of its anchor, (num_envs, 3 bodies) [m]."""
  return _bodies_b(env, command)[0].flatten(1)


def robot_body_ori_b(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Orientations of the robot's followed bodies in the frame of its anchor, (num_envs, 6 bodies)."""
  return _six(_bodies_b(env, command)[1]).flatten(1)


def motion(env: "ManagerBasedRlEnv", command: str) -> MotionCommand:
  """The motion command of that name.

  Raises:
    TypeError: The command is of another kind.
  """
  term = env.command_manager.get_term(command)
  if not isinstance(term, MotionCommand):
    raise TypeError(f"command '{command}' is a {type(term).__name__}, not a MotionCommand")
  return term


def _anchor_b(env: "ManagerBasedRlEnv", command: str) -> tuple[torch.Tensor, torch.Tensor]:
  term = motion(env, command)
  return subtract_frames(term.robot_anchor_pos_w, term.robot_anchor_quat_w, term.anchor_pos_w, term.anchor_quat_w)


def _bodies_b(env: "ManagerBasedRlEnv", command: str) -> tuple[torch.Tensor, torch.Tensor]:
  term = motion(env, command)
  pos, quat = term.robot_anchor_pos_w[:, None], term.robot_anchor_quat_w[:, None]
  return subtract_frames(pos, quat, term.robot_body_pos_w, term.robot_body_quat_w)


def _six(quat: torch.Tensor) -> torch.Tensor:
  return matrix_from_quat(quat)[..., :2].flatten(-2)
