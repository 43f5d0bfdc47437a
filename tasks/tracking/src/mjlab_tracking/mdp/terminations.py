"""Ends of a tracking episode: the clip is over, or the robot is too far from the reference."""

from typing import TYPE_CHECKING

import torch

from mjlab_tracking.mdp.errors import body_distance, norm
from mjlab_tracking.mdp.observations import motion

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def motion_end(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return True where the target of this step was the last frame of the clip, (num_envs,). Use it as a time-out."""
  term = motion(env, command)
  return term.frame >= term.num_frames - 1


def bad_anchor_height(env: "ManagerBasedRlEnv", *, command: str, threshold: float) -> torch.Tensor:
  """Return True where the anchors' heights differ by more than `threshold` [m], (num_envs,)."""
  term = motion(env, command)
  return (term.anchor_pos_w - term.robot_anchor_pos_w)[:, 2].abs() > threshold


def bad_anchor_drift(env: "ManagerBasedRlEnv", *, command: str, threshold: float) -> torch.Tensor:
  """Return True where the anchors are further apart than `threshold` [m] on the ground, (num_envs,)."""
  term = motion(env, command)
  return norm((term.anchor_pos_w - term.robot_anchor_pos_w)[:, :2]) > threshold


def bad_anchor_ori(env: "ManagerBasedRlEnv", *, command: str, threshold: float) -> torch.Tensor:
  """Return True where the z components of gravity in both anchors differ by more than `threshold`, (num_envs,)."""
  term = motion(env, command)
  return (_gravity_z(term.anchor_quat_w) - _gravity_z(term.robot_anchor_quat_w)).abs() > threshold


def bad_body_height(
  env: "ManagerBasedRlEnv", *, command: str, threshold: float, bodies: tuple[str, ...]
) -> torch.Tensor:
  """Return True where any of `bodies` differs by more than `threshold` [m] in height, (num_envs,)."""
  term = motion(env, command)
  error = (term.body_pos_relative_w - term.robot_body_pos_w)[..., 2]
  return (term.of_bodies(error, bodies).abs() > threshold).any(-1)


def bad_anchor_pos(env: "ManagerBasedRlEnv", *, command: str, threshold: float) -> torch.Tensor:
  """Return True where the anchors are further apart than `threshold` [m] in space, (num_envs,)."""
  term = motion(env, command)
  return norm(term.anchor_pos_w - term.robot_anchor_pos_w) > threshold


def bad_motion_body_pos(
  env: "ManagerBasedRlEnv", *, command: str, threshold: float, bodies: tuple[str, ...] | None = None
) -> torch.Tensor:
  """Return True where any of `bodies` is further than `threshold` [m] from the reference laid over the robot.

  Bool (num_envs,). Without `bodies`, all followed ones count.
  """
  term = motion(env, command)
  distance = body_distance(term)
  return (distance if bodies is None else term.of_bodies(distance, bodies)).amax(-1) > threshold


def _gravity_z(quat: torch.Tensor) -> torch.Tensor:
  """Return the z component of gravity's direction in frames, (N, 4) to (N,)."""
  return 2.0 * quat[:, 1:3].square().sum(-1) - 1.0
