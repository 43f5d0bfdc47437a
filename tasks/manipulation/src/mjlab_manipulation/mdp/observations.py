"""What a policy that lifts sees."""

from typing import TYPE_CHECKING

import torch
from mjlab_core.rotations import matrix_from_quat, quat_apply_inverse, quat_conjugate, quat_mul
from mjlab_managers import SceneEntityCfg

from mjlab_manipulation.mdp.rewards import lift_command

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def hand_to_object(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> torch.Tensor:
  """From the hand, one site, to the centre of the object, in the frame of the robot's root, (num_envs, 3) [m]."""
  data = env.scene[hand.name].data
  way = lift_command(env, command).object_pos_w - data.site_pos_w[:, hand.site_ids].squeeze(1)
  return quat_apply_inverse(data.root_link_quat_w, way)


def object_to_goal(env: "ManagerBasedRlEnv", *, command: str, robot: str = "robot") -> torch.Tensor:
  """From the centre of the object to its goal, in the frame of the robot's root, (num_envs, 3) [m]."""
  term = lift_command(env, command)
  return quat_apply_inverse(env.scene[robot].data.root_link_quat_w, term.goal_pos_w - term.object_pos_w)


def object_size(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Edges of the box about the object, in the frame of its body, (num_envs, 3) [m]."""
  return lift_command(env, command).object_size


def object_in_hand(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> torch.Tensor:
  """The object's first two axes in the frame of the hand, one site, one after the other, (num_envs, 6)."""
  quat = env.scene[hand.name].data.site_quat_w[:, hand.site_ids].squeeze(1)
  turn = quat_mul(quat_conjugate(quat), lift_command(env, command).object_quat_w)
  return matrix_from_quat(turn)[..., :2].mT.flatten(1)


def goal_in_hand(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> torch.Tensor:
  """The goal in the frame of the hand, one site, (num_envs, 3) [m]."""
  data = env.scene[hand.name].data
  place, quat = (value[:, hand.site_ids].squeeze(1) for value in (data.site_pos_w, data.site_quat_w))
  return quat_apply_inverse(quat, lift_command(env, command).goal_pos_w - place)
