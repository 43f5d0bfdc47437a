"""Observations that any task can use."""

from typing import TYPE_CHECKING

import torch
from mjlab_managers import SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_sensors import RayCastSensor

  from mjlab_envs.env import ManagerBasedRlEnv

_ROBOT = SceneEntityCfg("robot")


def base_lin_vel(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Linear velocity of the root, in the root frame, (num_envs, 3) [m/s]."""
  return env.scene[asset.name].data.root_link_lin_vel_b


def base_ang_vel(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Angular velocity of the root, in the root frame, (num_envs, 3) [rad/s]."""
  return env.scene[asset.name].data.root_link_ang_vel_b


def projected_gravity(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Unit direction of gravity in the root frame, (num_envs, 3)."""
  return env.scene[asset.name].data.projected_gravity_b


def joint_pos_rel(env: "ManagerBasedRlEnv", *, biased: bool = False, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Joint positions relative to the default pose, with the encoders' bias if `biased`, (num_envs, joints) [rad, m]."""
  data = env.scene[asset.name].data
  position = data.joint_pos_biased if biased else data.joint_pos
  return position[:, asset.joint_ids] - data.default_joint_pos[:, asset.joint_ids]


def joint_vel_rel(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Joint velocities relative to the default ones, (num_envs, joints) [rad/s, m/s]."""
  data = env.scene[asset.name].data
  return data.joint_vel[:, asset.joint_ids] - data.default_joint_vel[:, asset.joint_ids]


def last_action(env: "ManagerBasedRlEnv", *, term: str | None = None) -> torch.Tensor:
  """Raw action of the last step, of all terms or of one, (num_envs, action dim)."""
  return env.action_manager.action if term is None else env.action_manager.get_term(term).raw_action


def generated_commands(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """A command, (num_envs, command dim)."""
  return env.command_manager.get_command(command)


def builtin_sensor(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Reading of a native MuJoCo sensor, (num_envs, sensor dim)."""
  return env.scene[sensor].data


def height_scan(
  env: "ManagerBasedRlEnv", *, sensor: str, offset: float = 0.0, miss_value: float | None = None
) -> torch.Tensor:
  """Height of its frame above what each ray of a ray-cast sensor hits, less `offset`, (num_envs, num_rays) [m].

  A ray that hits nothing reads `miss_value`, by default the sensor's `max_distance`. Rays are ordered frame by frame.
  """
  scan: RayCastSensor = env.scene[sensor]
  data = scan.data
  below = data.frame_pos_w[..., 2:] - data.hit_pos_w[..., 2].unflatten(1, (scan.num_frames, scan.rays_per_frame))
  miss = scan.cfg.max_distance if miss_value is None else miss_value
  return (below.flatten(1) - offset).masked_fill_(~data.valid, miss)
