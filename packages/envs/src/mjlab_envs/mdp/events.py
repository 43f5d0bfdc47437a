"""Events that any task can use: resets and pushes."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

import torch
from mjlab_core import MjlabError, Range, check_name, quat_apply, quat_from_euler_xyz, quat_mul, uniform
from mjlab_managers import ManagerTermBase, SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_envs.base_env import ManagerBasedEnv

_ROBOT = SceneEntityCfg("robot")
_AXES = ("x", "y", "z", "roll", "pitch", "yaw")


def reset_scene_to_default(env: "ManagerBasedEnv", mask: torch.Tensor) -> None:
  """Put every entity into its default state at the origin of its world."""
  for entity in env.scene.entities.values():
    entity.write_default_state(env.scene.env_origins, mask)


class reset_root_state_uniform(ManagerTermBase):
  """Put the root at its default state, moved by a uniform offset, at the origin of its world.

  Ranges are by axis (x, y, z [m], roll, pitch, yaw [rad]; velocities in world frame [m/s, rad/s]); those left out are
  zero. The sampled rotation is applied in the body frame.
  """

  env: "ManagerBasedEnv"

  def __init__(
    self,
    env: "ManagerBasedEnv",
    *,
    pose_range: dict[str, Range],
    velocity_range: dict[str, Range] | None = None,
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    super().__init__(env)
    self._pose_lo, self._pose_hi = axis_bounds(pose_range, "pose_range", env)
    self._vel_lo, self._vel_hi = axis_bounds(velocity_range, "velocity_range", env)
    self._entity = env.scene[asset.name]

  def __call__(self, mask: torch.Tensor) -> None:
    env, entity = self.env, self._entity
    default = entity.data.default_root_state
    offset = drawn(env, self._pose_lo, self._pose_hi, 6)
    position = default[:, :3] + offset[:, :3] + self.origins()
    orientation = quat_mul(default[:, 3:7], quat_from_euler_xyz(offset[:, 3], offset[:, 4], offset[:, 5]))
    if entity.is_fixed_base:
      entity.write_root_pose(torch.cat([position, orientation], -1), mask)
      return
    velocity = default[:, 7:] + drawn(env, self._vel_lo, self._vel_hi, 6)
    entity.write_root_state(torch.cat([position, orientation, velocity], -1), mask)

  def origins(self) -> torch.Tensor:
    """Return the points from which default states are counted, (num_envs, 3) [m]."""
    return self.env.scene.env_origins


class reset_joints_by_offset(ManagerTermBase):
  """Put joints at their default state plus uniform offsets [rad, m] and [rad/s, m/s], inside their soft limits."""

  env: "ManagerBasedEnv"

  def __init__(
    self,
    env: "ManagerBasedEnv",
    *,
    position_range: Range,
    velocity_range: Range,
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    super().__init__(env)
    self._position_range, self._velocity_range, self._asset = position_range, velocity_range, asset
    self._entity = env.scene[asset.name]
    names = cast("tuple[str, ...]", asset.joint_names)
    self._joints = [self._entity.joint_names.index(name) for name in names]
    if ball := [name for name in self._entity.wide_joints if name in names]:
      raise MjlabError(f"reset_joints_by_offset: a quaternion, that of ball joint '{ball[0]}', takes no offsets")

  def __call__(self, mask: torch.Tensor) -> None:
    env, entity = self.env, self._entity
    data, ids, v_ids = entity.data, self._asset.joint_pos_ids, self._asset.joint_vel_ids
    position = data.default_joint_pos[:, ids]
    count = position.shape[1]
    limits = data.soft_joint_pos_limits[:, ids]
    position = (position + drawn(env, *self._position_range, count)).clamp(limits[..., 0], limits[..., 1])
    velocity = data.default_joint_vel[:, v_ids] + drawn(env, *self._velocity_range, count)
    entity.write_joint_state(position, velocity, mask=mask, joint_ids=self._joints)


class push_by_setting_velocity(ManagerTermBase):
  """Add a uniform twist to the root's velocity, world frame; ranges by axis as in `reset_root_state_uniform`.

  Works on state alone, so that a push costs no separate forward pass.
  """

  env: "ManagerBasedEnv"

  def __init__(
    self, env: "ManagerBasedEnv", *, velocity_range: dict[str, Range], asset: SceneEntityCfg = _ROBOT
  ) -> None:
    super().__init__(env)
    self._lo, self._hi = axis_bounds(velocity_range, "velocity_range", env)
    self._entity = env.scene[asset.name]
    if self._entity.is_fixed_base:
      raise MjlabError(f"entity '{self._entity.name}': its base does not float, so it has no velocity to push")

  def __call__(self, mask: torch.Tensor) -> None:
    env, entity = self.env, self._entity
    twist, data = drawn(env, self._lo, self._hi, 6), entity.data
    spin = quat_apply(data.root_link_quat_w, data.root_link_ang_vel_b)
    entity.write_root_velocity(torch.cat([data.root_link_lin_vel_w, spin], -1) + twist, mask)


def drawn(env: "ManagerBasedEnv", lo: torch.Tensor | float, hi: torch.Tensor | float, *shape: int) -> torch.Tensor:
  """Return uniform draws from [lo, hi], (num_envs, *shape)."""
  return uniform(lo, hi, (env.num_envs, *shape), generator=env.rng, device=env.device, dtype=env.sim.dtype)


def axis_bounds(
  ranges: dict[str, Range] | None, name: str, env: "ManagerBasedEnv", axes: Sequence[str] = _AXES
) -> tuple[torch.Tensor, torch.Tensor]:
  """Return lower and upper bounds, (1, number of axes), of ranges by axis; axes left out are (0, 0).

  Raises:
    UnknownNameError: an axis does not exist.
  """
  ranges = ranges or {}
  for axis in ranges:
    check_name("axis", axis, axes, name)
  bounds = torch.tensor([ranges.get(axis, (0.0, 0.0)) for axis in axes], device=env.device, dtype=env.sim.dtype)
  return bounds[None, :, 0], bounds[None, :, 1]
