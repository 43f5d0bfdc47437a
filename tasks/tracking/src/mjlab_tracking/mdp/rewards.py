"""Rewards of tracking: kernels exp(-x / std^2) of squared errors."""

from typing import TYPE_CHECKING

import torch
from mjlab_core import quat_error_magnitude
from mjlab_managers import ManagerTermBase

from mjlab_tracking.mdp.errors import body_angle, body_distance, body_speed_error, body_spin_error, norm
from mjlab_tracking.mdp.observations import motion

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


def motion_global_root_pos(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """Return exp(-|p_ref - p|^2 / std^2) of the anchors' positions in the world, (num_envs,); `std` in m."""
  term = motion(env, command)
  return _kernel((term.anchor_pos_w - term.robot_anchor_pos_w).square().sum(-1), std)


def motion_global_root_ori(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """Return exp(-angle^2 / std^2) between the anchors, (num_envs,); `std` in rad."""
  term = motion(env, command)
  return _kernel(quat_error_magnitude(term.anchor_quat_w, term.robot_anchor_quat_w).square(), std)


def motion_body_pos(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """Return exp(-mean_b |p_b,ref - p_b|^2 / std^2) with the reference laid over the robot, (num_envs,); `std` in m."""
  return _kernel(body_distance(motion(env, command)).square().mean(-1), std)


def motion_body_ori(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """Return exp(-mean_b angle_b^2 / std^2) with the reference laid over the robot, (num_envs,); `std` in rad."""
  return _kernel(body_angle(motion(env, command)).square().mean(-1), std)


def motion_body_lin_vel(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """Return exp(-mean_b |v_b,ref - v_b|^2 / std^2) of velocities in the world, (num_envs,); `std` in m/s."""
  return _kernel(body_speed_error(motion(env, command)).square().mean(-1), std)


def motion_body_ang_vel(env: "ManagerBasedRlEnv", *, command: str, std: float) -> torch.Tensor:
  """Return exp(-mean_b |w_b,ref - w_b|^2 / std^2) of angular velocities in the world, (num_envs,); `std` in rad/s."""
  return _kernel(body_spin_error(motion(env, command)).square().mean(-1), std)


class motion_contact(ManagerTermBase):
  """Share of feet whose contact with the ground is that of the reference, (num_envs,).

  A foot of the reference touches while its body's origin is less than `height` above its lowest place in all clips,
  and slower than `speed`. `sensor` is a contact sensor with one primary for each of `bodies`, in their order.
  """

  env: "ManagerBasedRlEnv"

  def __init__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    command: str,
    sensor: str,
    bodies: tuple[str, ...],
    height: float = 0.03,
    speed: float = 0.3,
  ) -> None:
    super().__init__(env)
    self._term, self._bodies, self._sensor = motion(env, command), bodies, env.scene[sensor]
    self._height, self._speed = height, speed
    library = self._term.library
    heights = library.part(library.table, "body_pos")[..., 2]
    self._ground = self._term.of_bodies(heights, bodies).amin(0)

  def __call__(self) -> torch.Tensor:
    term = self._term
    above = term.of_bodies(term.body_pos_w, self._bodies)[..., 2] - self.env.scene.env_origins[:, 2:] - self._ground
    is_slow = norm(term.of_bodies(term.body_lin_vel_w, self._bodies)) < self._speed
    stands = (above < self._height) & is_slow
    return (stands == (self._sensor.data.found > 0)).float().mean(-1)


def _kernel(error: torch.Tensor, std: float) -> torch.Tensor:
  return torch.exp(error / -(std**2))
