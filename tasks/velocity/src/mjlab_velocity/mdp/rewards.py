"""Rewards of velocity tracking, and observations of feet. Gait terms are 0 up to the commanded speed `threshold`."""

from typing import TYPE_CHECKING, cast

import torch
from mjlab_core import MjlabError, fill_
from mjlab_envs.mdp.rewards import inverse_variance
from mjlab_managers import ManagerTermBase, SceneEntityCfg

from mjlab_velocity.mdp.command import UniformVelocityCommand

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

_ROBOT = SceneEntityCfg("robot")


def track_linear_velocity(
  env: "ManagerBasedRlEnv", *, command: str, std: float, asset: SceneEntityCfg = _ROBOT
) -> torch.Tensor:
  """Return exp(-(|v_xy - u_xy|^2 + v_z^2) / std^2), root velocity in the root frame, (num_envs,)."""
  error = linear_error_squared(env, command=command, entity=asset.name)
  return torch.exp((error + env.scene[asset.name].data.root_link_lin_vel_b[:, 2].square()) / -(std**2))


def track_angular_velocity(
  env: "ManagerBasedRlEnv", *, command: str, std: float, asset: SceneEntityCfg = _ROBOT
) -> torch.Tensor:
  """Return exp(-((w_z - u_z)^2 + |w_xy|^2) / std^2), root angular velocity in the root frame, (num_envs,)."""
  error = turning_error_squared(env, command=command, entity=asset.name)
  tumbling = env.scene[asset.name].data.root_link_ang_vel_b[:, :2].square().sum(-1)
  return torch.exp((error + tumbling) / -(std**2))


def linear_error_squared(env: "ManagerBasedRlEnv", *, command: str, entity: str = "robot") -> torch.Tensor:
  """Return |v_xy - u_xy|^2 in the root frame, (num_envs,) [m^2/s^2]."""
  velocity = env.scene[entity].data.root_link_lin_vel_b
  return (velocity[:, :2] - env.command_manager.get_command(command)[:, :2]).square().sum(-1)


def turning_error_squared(env: "ManagerBasedRlEnv", *, command: str, entity: str = "robot") -> torch.Tensor:
  """Return (w_z - u_z)^2 in the root frame, (num_envs,) [rad^2/s^2]."""
  velocity = env.scene[entity].data.root_link_ang_vel_b
  return (velocity[:, 2] - env.command_manager.get_command(command)[:, 2]).square()


class upright(ManagerTermBase):
  """exp(-|g_xy|^2 / std^2) of the unit direction of gravity in the frame of one body, (num_envs,)."""

  env: "ManagerBasedRlEnv"

  def __init__(self, env: "ManagerBasedRlEnv", *, std: float, asset: SceneEntityCfg) -> None:
    super().__init__(env)
    self._std = std
    names = cast("tuple[str, ...]", asset.body_names)
    if len(names) != 1:
      raise MjlabError(f"`asset` must select one body, selects {len(names)}: {', '.join(names)}")
    self._body = int(env.scene[asset.name].indexing.ids["body"][env.scene[asset.name].body_names.index(names[0])])

  def __call__(self) -> torch.Tensor:
    # The last row of a rotation matrix is the world's z axis in the body.
    return torch.exp(self.env.sim.data.xmat[:, self._body, 2, :2].square().sum(-1) / -(self._std**2))


def body_ang_vel_xy_l2(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg) -> torch.Tensor:
  """Return w_x^2 + w_y^2 of bodies, world frame, summed over bodies, (num_envs,) [rad^2/s^2]."""
  return env.scene[asset.name].data.body_link_ang_vel_w[:, asset.body_ids, :2].square().sum((-1, -2))


def angular_momentum_l2(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return the squared norm of the angular momentum about the centre of mass, (num_envs,) [kg^2 m^4/s^2]."""
  return env.scene[sensor].data.square().sum(-1)


class variable_posture(ManagerTermBase):
  """exp(-mean_j((q_j - q_default_j)^2 / std_j^2)), with deviations for standing, walking and running, (num_envs,).

  The commanded speed |v_xy| + |w_z| selects them: walking from `walking_threshold`, running from
  `running_threshold`.
  """

  env: "ManagerBasedRlEnv"

  def __init__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    command: str,
    std_standing: dict[str, float],
    std_walking: dict[str, float],
    std_running: dict[str, float],
    walking_threshold: float = 0.05,
    running_threshold: float = 1.5,
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    super().__init__(env)
    stds = (std_standing, std_walking, std_running)
    self._table = torch.cat([inverse_variance(std, asset, env) for std in stds])
    self._thresholds = torch.tensor([[walking_threshold, running_threshold]], device=env.device, dtype=torch.float32)
    self._command, self._entity, self._joints = command, env.scene[asset.name], asset.joint_pos_ids

  def __call__(self) -> torch.Tensor:
    data = self._entity.data
    error = data.joint_pos[:, self._joints] - data.default_joint_pos[:, self._joints]
    gait = (_speed(self.env, self._command)[:, None] >= self._thresholds).sum(-1)
    return torch.exp(-(error.square() * self._table.index_select(0, gait)).mean(-1))


def feet_air_time(
  env: "ManagerBasedRlEnv", *, sensor: str, command: str, threshold: float, lo: float = 0.05, hi: float = 0.5
) -> torch.Tensor:
  """Return the number of feet that have been in the air for lo to hi [s], (num_envs,)."""
  air = env.scene[sensor].data.current_air_time
  return ((air > lo) & (air < hi)).sum(-1, dtype=air.dtype) * _moves(env, command, threshold)


def feet_clearance(
  env: "ManagerBasedRlEnv", *, heights: str, command: str, threshold: float, target: float, feet: SceneEntityCfg
) -> torch.Tensor:
  """Return sum_f |h_f - target| |v_xy,f|, heights above the ground, (num_envs,) [m^2/s]."""
  error = (env.scene[heights].data.heights - target).abs()
  speed = torch.linalg.vector_norm(_feet_velocity(env, feet), dim=-1)
  return (error * speed).sum(-1) * _moves(env, command, threshold)


class feet_swing_height(ManagerTermBase):
  """sum over landing feet of (peak / target - 1)^2, peak being the swing's greatest height, (num_envs,).

  A swing begins when the foot leaves the ground. The drop at the start of an episode and swings of the episode before
  do not count.
  """

  env: "ManagerBasedRlEnv"

  def __init__(
    self, env: "ManagerBasedRlEnv", *, sensor: str, heights: str, command: str, threshold: float, target: float
  ) -> None:
    super().__init__(env)
    self._sensor, self._heights, self._command = sensor, env.scene[heights], command
    self._threshold, self._target = threshold, target
    feet = len(env.scene[sensor].primary_names)
    self._peak = self.state((feet,), dtype=env.sim.dtype)

  def __call__(self) -> torch.Tensor:
    env, peak = self.env, self._peak
    torch.maximum(peak, self._heights.data.heights, out=peak)
    error = (peak / self._target - 1.0).square()
    cost = (error * landed(env, self._sensor)).sum(-1) * _moves(env, self._command, self._threshold)
    fill_(peak, env.scene[self._sensor].data.found > 0, 0.0)
    return cost


def feet_slip(
  env: "ManagerBasedRlEnv", *, sensor: str, command: str, threshold: float, feet: SceneEntityCfg
) -> torch.Tensor:
  """Return the squared horizontal speed of feet in contact, summed over feet, (num_envs,) [m^2/s^2]."""
  slip = _feet_velocity(env, feet).square().sum(-1)
  return (slip * (env.scene[sensor].data.found > 0)).sum(-1) * _moves(env, command, threshold)


def soft_landing(env: "ManagerBasedRlEnv", *, sensor: str, command: str, threshold: float) -> torch.Tensor:
  """Return `landing_force`, (num_envs,) [N]."""
  return landing_force(env, sensor=sensor) * _moves(env, command, threshold)


def landing_force(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return the net contact force of feet that just landed, summed over feet, (num_envs,) [N].

  The drop at the start of an episode does not count.
  """
  force = torch.linalg.vector_norm(env.scene[sensor].data.force, dim=-1)
  return (force * landed(env, sensor)).sum(-1)


def landed(env: "ManagerBasedRlEnv", sensor: str) -> torch.Tensor:
  """Return True for feet that landed in this step and had taken off in the same episode, (num_envs, feet)."""
  contact = env.scene[sensor]
  # A time of contact is stored at take-off only.
  return contact.compute_first_contact(env.step_dt) & (contact.data.last_contact_time > 0)


def _moves(env: "ManagerBasedRlEnv", command: str, threshold: float) -> torch.Tensor:
  """Return True where the commanded speed exceeds `threshold`, (num_envs,)."""
  return _speed(env, command) > threshold


def _speed(env: "ManagerBasedRlEnv", command: str) -> torch.Tensor:
  """Return |v_xy| + |w_z| of a velocity command, (num_envs,)."""
  return cast("UniformVelocityCommand", env.command_manager.get_term(command)).speed


def _feet_velocity(env: "ManagerBasedRlEnv", feet: SceneEntityCfg) -> torch.Tensor:
  """Return the horizontal velocity of the feet's sites, world frame, (num_envs, feet, 2) [m/s]."""
  return env.scene[feet.name].data.site_lin_vel_w[:, feet.site_ids, :2]


def foot_height(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return the height of each foot above the ground, (num_envs, feet) [m]."""
  return env.scene[sensor].data.heights


def foot_air_time(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return the time that each foot has been in the air, (num_envs, feet) [s]."""
  return env.scene[sensor].data.current_air_time


def foot_contact(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return 1 for each foot on the ground, (num_envs, feet)."""
  return (env.scene[sensor].data.found > 0).float()


def foot_contact_forces(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return sign(f) log(1 + |f|) of the net contact force of each foot, world frame, (num_envs, 3 feet) [log N]."""
  force = env.scene[sensor].data.force.flatten(1)
  return torch.sign(force) * torch.log1p(force.abs())
