"""Rewards of tracking: kernels exp(-x / std^2) of squared errors."""

from typing import TYPE_CHECKING

import torch
from mjlab_core.rotations import quat_error_magnitude
from mjlab_managers import ManagerTermBase, RewardTermCfg

from mjlab_tracking.mdp.errors import body_angle, body_distance, body_speed_error, body_spin_error
from mjlab_tracking.mdp.observations import motion

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def motion_global_root_pos(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """exp(-|p_ref - p|^2 / std^2) of the anchors' positions in the world, (num_envs,); `std` in m."""
  term = motion(env, command)
  return _kernel((term.anchor_pos_w - term.robot_anchor_pos_w).square().sum(-1), std)


def motion_global_root_ori(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """exp(-angle^2 / std^2) between the anchors, (num_envs,); `std` in rad."""
  term = motion(env, command)
  return _kernel(quat_error_magnitude(term.anchor_quat_w, term.robot_anchor_quat_w).square(), std)


def motion_body_pos(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """exp(-mean_b |p_b,ref - p_b|^2 / std^2) with the reference laid over the robot, (num_envs,); `std` in m."""
  return _kernel(body_distance(motion(env, command)).square().mean(-1), std)


def motion_body_ori(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """exp(-mean_b angle_b^2 / std^2) with the reference laid over the robot, (num_envs,); `std` in rad."""
  return _kernel(body_angle(motion(env, command)).square().mean(-1), std)


def motion_body_lin_vel(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """exp(-mean_b |v_b,ref - v_b|^2 / std^2) of velocities in the world, (num_envs,); `std` in m/s."""
  return _kernel(body_speed_error(motion(env, command)).square().mean(-1), std)


def motion_body_ang_vel(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """exp(-mean_b |w_b,ref - w_b|^2 / std^2) of angular velocities in the world, (num_envs,); `std` in rad/s."""
  return _kernel(body_spin_error(motion(env, command)).square().mean(-1), std)


class motion_contact(ManagerTermBase):
  """Share of feet that touch the ground where the reference's do and do not where they do not, (num_envs,).

  A foot of the reference touches while its body's origin is less than `height` above where it is lowest in all clips,
  and slower than `speed`. `sensor` is a contact sensor with one primary for each of `bodies`, in their order.
  """

  _constants = frozenset({"_columns", "_ground"})

  def __init__(self, cfg: RewardTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    term = motion(env, cfg.params["command"])
    bodies = cfg.params["bodies"]
    if unknown := [body for body in bodies if body not in term.cfg.bodies]:
      raise ValueError(f"bodies: '{unknown[0]}' is not followed; these are: {', '.join(term.cfg.bodies)}")
    self._columns = torch.tensor([term.cfg.bodies.index(body) for body in bodies], device=env.device)
    library = term.library
    heights = library.table[:, library.columns["body_pos"]].unflatten(1, (-1, 3))[..., 2]
    self._ground = heights.index_select(1, self._columns).amin(0)

  def __call__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    command: str,
    sensor: str,
    bodies: tuple[str, ...],
    height: float = 0.03,
    speed: float = 0.3,
  ) -> torch.Tensor:
    del bodies  # Resolved at build.
    term = motion(env, command)
    above = term.body_pos_w.index_select(1, self._columns)[..., 2] - env.scene.env_origins[:, 2:] - self._ground
    moving = torch.linalg.vector_norm(term.body_lin_vel_w.index_select(1, self._columns), dim=-1)
    stands = (above < height) & (moving < speed)
    touches = env.scene[sensor].data.found > 0
    return (stands == touches).float().mean(-1)


def _kernel(error: torch.Tensor, std: float) -> torch.Tensor:
  return torch.exp(error / -(std**2))
