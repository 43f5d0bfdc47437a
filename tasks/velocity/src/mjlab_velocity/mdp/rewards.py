"""Rewards of velocity tracking. The gate of a gait term is the command: a robot told to stand is not judged by it."""

from typing import TYPE_CHECKING, cast

import torch
from mjlab_core.masking import fill_
from mjlab_envs.mdp.rewards import inverse_variance
from mjlab_managers import ManagerTermBase, RewardTermCfg, SceneEntityCfg

from mjlab_velocity.mdp.command import UniformVelocityCommand

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

_ROBOT = SceneEntityCfg("robot")


def track_linear_velocity(
  env: "ManagerBasedRlEnv", *, command: str, std: float, asset: SceneEntityCfg = _ROBOT
) -> torch.Tensor:
  """exp(-(|v_xy - u_xy|^2 + v_z^2) / std^2), root velocity in the root frame, (num_envs,)."""
  velocity = env.scene[asset.name].data.root_link_lin_vel_b
  error = (velocity[:, :2] - env.command_manager.get_command(command)[:, :2]).square().sum(-1)
  return torch.exp((error + velocity[:, 2].square()) / -(std**2))


def track_angular_velocity(
  env: "ManagerBasedRlEnv", *, command: str, std: float, asset: SceneEntityCfg = _ROBOT
) -> torch.Tensor:
  """exp(-((w_z - u_z)^2 + |w_xy|^2) / std^2), root angular velocity in the root frame, (num_envs,)."""
  velocity = env.scene[asset.name].data.root_link_ang_vel_b
  error = (velocity[:, 2] - env.command_manager.get_command(command)[:, 2]).square()
  return torch.exp((error + velocity[:, :2].square().sum(-1)) / -(std**2))


class upright(ManagerTermBase):
  """exp(-|g_xy|^2 / std^2) of the unit direction of gravity in the frame of one body, (num_envs,)."""

  def __init__(self, cfg: RewardTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    asset: SceneEntityCfg = cfg.params["asset"]
    names = cast("tuple[str, ...]", asset.body_names)
    if len(names) != 1:
      raise ValueError(f"one body is to stay upright, but {len(names)} are selected: {', '.join(names)}")
    self._body = int(env.scene[asset.name].indexing.ids["body"][env.scene[asset.name].body_names.index(names[0])])

  def __call__(self, env: "ManagerBasedRlEnv", *, std: float, asset: SceneEntityCfg) -> torch.Tensor:
    del asset  # Resolved at build.
    # The last row of a rotation matrix is the world's z axis in the body.
    return torch.exp(env.sim.data.xmat[:, self._body, 2, :2].square().sum(-1) / -(std**2))


def body_ang_vel_xy_l2(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg) -> torch.Tensor:
  """w_x^2 + w_y^2 of bodies, world frame, summed over bodies, (num_envs,) [rad^2/s^2]."""
  return env.scene[asset.name].data.body_link_ang_vel_w[:, asset.body_ids, :2].square().sum((-1, -2))


def angular_momentum_l2(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Squared norm of the angular momentum about the centre of mass, (num_envs,) [kg^2 m^4/s^2]."""
  return env.scene[sensor].data.square().sum(-1)


class variable_posture(ManagerTermBase):
  """exp(-mean_j((q_j - q_default_j)^2 / std_j^2)), with deviations for standing, walking and running, (num_envs,).

  Which ones apply follows the commanded speed |v_xy| + |w_z|: walking from `walking_threshold`, running from
  `running_threshold`.
  """

  _constants = frozenset({"_table", "_thresholds"})

  def __init__(self, cfg: RewardTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    asset, params = cfg.params["asset"], cfg.params
    self._table = torch.cat(
      [inverse_variance(params[f"std_{gait}"], asset, env) for gait in ("standing", "walking", "running")]
    )
    self._thresholds = torch.tensor([[params["walking_threshold"], params["running_threshold"]]], device=env.device)

  def __call__(
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
  ) -> torch.Tensor:
    del std_standing, std_walking, std_running, walking_threshold, running_threshold  # Resolved at build.
    data = env.scene[asset.name].data
    error = data.joint_pos[:, asset.joint_ids] - data.default_joint_pos[:, asset.joint_ids]
    gait = (_speed(env, command)[:, None] >= self._thresholds).sum(-1)
    return torch.exp(-(error.square() * self._table.index_select(0, gait)).mean(-1))


def feet_air_time(
  env: "ManagerBasedRlEnv", *, sensor: str, command: str, threshold: float, lo: float = 0.05, hi: float = 0.5
) -> torch.Tensor:
  """Number of feet that have been in the air for lo to hi [s], (num_envs,); gated by `threshold`."""
  air = env.scene[sensor].data.current_air_time
  return ((air > lo) & (air < hi)).sum(-1, dtype=air.dtype) * _moves(env, command, threshold)


def feet_clearance(
  env: "ManagerBasedRlEnv", *, heights: str, command: str, threshold: float, target: float, feet: SceneEntityCfg
) -> torch.Tensor:
  """sum_f |h_f - target| |v_xy,f|, heights above the ground, (num_envs,) [m^2/s]; gated by `threshold`."""
  error = (env.scene[heights].data.heights - target).abs()
  speed = torch.linalg.vector_norm(_feet_velocity(env, feet), dim=-1)
  return (error * speed).sum(-1) * _moves(env, command, threshold)


class feet_swing_height(ManagerTermBase):
  """sum over landing feet of (peak / target - 1)^2, peak being the swing's greatest height, (num_envs,).

  A swing begins where the foot leaves the ground: the drop at the start of an episode is none, and what a foot did in
  the episode before does not count.
  """

  def __init__(self, cfg: RewardTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    feet = env.scene[cfg.params["sensor"]].num_primaries
    if env.scene[cfg.params["heights"]].num_frames != feet:
      raise ValueError(f"sensors '{cfg.params['sensor']}' and '{cfg.params['heights']}' see different numbers of feet")
    self._peak = torch.zeros(env.num_envs, feet, device=env.device, dtype=env.sim.dtype)

  def __call__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    sensor: str,
    heights: str,
    command: str,
    threshold: float,
    target: float,
  ) -> torch.Tensor:
    contact = env.scene[sensor]
    torch.maximum(self._peak, env.scene[heights].data.heights, out=self._peak)
    cost = ((self._peak / target - 1.0).square() * _landed(env, sensor)).sum(-1) * _moves(env, command, threshold)
    fill_(self._peak, contact.data.found > 0, 0.0)
    return cost

  def reset(self, mask: torch.Tensor) -> None:
    fill_(self._peak, mask, 0.0)


def feet_slip(
  env: "ManagerBasedRlEnv", *, sensor: str, command: str, threshold: float, feet: SceneEntityCfg
) -> torch.Tensor:
  """Squared horizontal speed of feet in contact, summed over feet, (num_envs,) [m^2/s^2]; gated by `threshold`."""
  slip = _feet_velocity(env, feet).square().sum(-1)
  return (slip * (env.scene[sensor].data.found > 0)).sum(-1) * _moves(env, command, threshold)


def soft_landing(env: "ManagerBasedRlEnv", *, sensor: str, command: str, threshold: float) -> torch.Tensor:
  """Net contact force of feet that just landed, summed over feet, (num_envs,) [N]; gated by `threshold`.

  The drop at the start of an episode is no landing.
  """
  force = torch.linalg.vector_norm(env.scene[sensor].data.force, dim=-1)
  return (force * _landed(env, sensor)).sum(-1) * _moves(env, command, threshold)


def _landed(env: "ManagerBasedRlEnv", sensor: str) -> torch.Tensor:
  """Which feet came down in this step, having taken off in the same episode, (num_envs, feet) bool."""
  contact = env.scene[sensor]
  # Only a take-off leaves behind a time of contact.
  return contact.compute_first_contact(env.step_dt) & (contact.data.last_contact_time > 0)


def _moves(env: "ManagerBasedRlEnv", command: str, threshold: float) -> torch.Tensor:
  """Whether the commanded speed exceeds `threshold`, (num_envs,)."""
  return _speed(env, command) > threshold


def _speed(env: "ManagerBasedRlEnv", command: str) -> torch.Tensor:
  """|v_xy| + |w_z| of a velocity command, (num_envs,)."""
  return cast("UniformVelocityCommand", env.command_manager.get_term(command)).speed


def _feet_velocity(env: "ManagerBasedRlEnv", feet: SceneEntityCfg) -> torch.Tensor:
  """Horizontal velocity of the feet's sites, world frame, (num_envs, feet, 2) [m/s]."""
  return env.scene[feet.name].data.site_lin_vel_w[:, feet.site_ids, :2]
