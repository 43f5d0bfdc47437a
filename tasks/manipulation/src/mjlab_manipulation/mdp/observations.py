"""What a policy that lifts sees."""

from typing import TYPE_CHECKING

import torch
from mjlab_core.rotations import quat_apply_inverse
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


def goal_in_hand(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> torch.Tensor:
  """The goal in the frame of the hand, one site, (num_envs, 3) [m]."""
  data = env.scene[hand.name].data
  place, quat = (value[:, hand.site_ids].squeeze(1) for value in (data.site_pos_w, data.site_quat_w))
  return quat_apply_inverse(quat, lift_command(env, command).goal_pos_w - place)
