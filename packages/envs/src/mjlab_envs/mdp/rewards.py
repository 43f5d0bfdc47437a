"""Rewards and metrics that any task can use."""

from typing import TYPE_CHECKING, Any, cast

import torch
from mjlab_core import match_values_full
from mjlab_managers import ManagerTermBase, SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv

_ROBOT = SceneEntityCfg("robot")


def is_alive(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Return 1 while the episode did not end in failure, (num_envs,)."""
  return (~env.termination_manager.terminated).float()


def is_terminated(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Return 1 where the episode ended in failure, (num_envs,)."""
  return env.termination_manager.terminated.float()


def action_rate_l2(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Return |a_t - a_{t-1}|^2 of raw actions, (num_envs,)."""
  return (env.action_manager.action - env.action_manager.prev_action).square().sum(-1)


def action_acc_l2(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Return |a_t - 2 a_{t-1} + a_{t-2}|^2 of raw actions, (num_envs,)."""
  return _action_acc(env).square().sum(-1)


def mean_action_acc(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Return mean_j |a_t - 2 a_{t-1} + a_{t-2}| of raw actions, (num_envs,)."""
  return _action_acc(env).abs().mean(-1)


def _action_acc(env: "ManagerBasedRlEnv") -> torch.Tensor:
  manager = env.action_manager
  return manager.action - 2.0 * manager.prev_action + manager.prev_prev_action


def joint_torques_l2(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Return squared actuator forces, summed over actuators, (num_envs,) [N^2 m^2]."""
  return env.scene[asset.name].data.actuator_force[:, asset.actuator_ids].square().sum(-1)


def joint_vel_l2(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Return squared joint velocities, summed over joints, (num_envs,) [rad^2/s^2]."""
  return env.scene[asset.name].data.joint_vel[:, asset.joint_vel_ids].square().sum(-1)


def joint_acc_l2(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Return squared joint accelerations, summed over joints, (num_envs,) [rad^2/s^4]."""
  return env.scene[asset.name].data.joint_acc[:, asset.joint_vel_ids].square().sum(-1)


def electrical_power_cost(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Return sum_j max(force_j velocity_j, 0) of the actuators at the joints, (num_envs,) [W]; braking counts 0."""
  data = env.scene[asset.name].data
  power = data.qfrc_actuator[:, asset.joint_vel_ids] * data.joint_vel[:, asset.joint_vel_ids]
  return power.clamp(min=0.0).sum(-1)


def joint_pos_limits(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Return the distance of joint positions beyond their soft limits, summed over joints, (num_envs,) [rad, m]."""
  data = env.scene[asset.name].data
  position = data.joint_pos[:, asset.joint_pos_ids]
  limits = data.soft_joint_pos_limits[:, asset.joint_pos_ids]
  return (position - position.clamp(limits[..., 0], limits[..., 1])).abs().sum(-1)


def joint_vel_limits(
  env: "ManagerBasedRlEnv", *, soft_ratio: float = 1.0, asset: SceneEntityCfg = _ROBOT
) -> torch.Tensor:
  """Return sum_j max(|qd_j| - `soft_ratio` limit_j, 0) over the selected joints, (num_envs,) [rad/s, m/s].

  Limits are `velocity_limit` of the actuators.
  """
  data = env.scene[asset.name].data
  excess = data.joint_vel[:, asset.joint_vel_ids].abs() - soft_ratio * data.joint_vel_limits[:, asset.joint_vel_ids]
  return excess.clamp(min=0.0).sum(-1)


def flat_orientation_l2(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg = _ROBOT) -> torch.Tensor:
  """Return the squared horizontal part of the gravity direction in the root frame, (num_envs,)."""
  return env.scene[asset.name].data.projected_gravity_b[:, :2].square().sum(-1)


class posture(ManagerTermBase):
  """Return exp(-mean_j((q_j - q_default_j)^2 / std_j^2)), (num_envs,).

  `std` is one number, or one per joint by pattern [rad].
  """

  def __init__(
    self, env: "ManagerBasedRlEnv", *, std: float | dict[str, float], asset: SceneEntityCfg = _ROBOT
  ) -> None:
    super().__init__(env)
    self._inverse_variance = inverse_variance(std, asset, env)
    self._entity, self._joints = env.scene[asset.name], asset.joint_pos_ids

  def __call__(self) -> torch.Tensor:
    data = self._entity.data
    error = data.joint_pos[:, self._joints] - data.default_joint_pos[:, self._joints]
    return torch.exp(-(error.square() * self._inverse_variance).mean(-1))


def inverse_variance(std: float | dict[str, float], asset: SceneEntityCfg, env: Any) -> torch.Tensor:
  """Return 1 / std^2 of the selected joints, (1, joints)."""
  # A resolved selection holds the selected names.
  names = cast("tuple[str, ...]", asset.joint_names)
  values = match_values_full(std, names, what="joint", owner=f"entity '{asset.name}'")
  return torch.tensor([values], device=env.device, dtype=env.sim.dtype).pow(-2)
