"""Events that any task can use: resets and pushes."""

from typing import TYPE_CHECKING

import torch
from mjlab_core.names import unknown
from mjlab_core.rotations import quat_apply, quat_from_euler_xyz, quat_mul
from mjlab_core.sampling import check_range, uniform
from mjlab_managers import EventTermCfg, ManagerTermBase, SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv

Range = tuple[float, float]
_ROBOT = SceneEntityCfg("robot")
_AXES = ("x", "y", "z", "roll", "pitch", "yaw")


def reset_scene_to_default(env: "ManagerBasedRlEnv", mask: torch.Tensor) -> None:
  """Put every entity into its default state at the origin of its world."""
  for entity in env.scene.entities.values():
    entity.write_default_state(env.scene.env_origins, mask)


class reset_root_state_uniform(ManagerTermBase):
  """Put the root at its default state, moved by a uniform offset, at the origin of its world.

  Ranges are by axis (x, y, z [m], roll, pitch, yaw [rad]; velocities in world frame [m/s, rad/s]); those left out are
  zero. The sampled rotation is applied in the body frame.
  """

  _constants = frozenset({"_pose_lo", "_pose_hi", "_vel_lo", "_vel_hi"})

  def __init__(self, cfg: EventTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._pose_lo, self._pose_hi = axis_bounds(cfg.params["pose_range"], "pose_range", env)
    self._vel_lo, self._vel_hi = axis_bounds(cfg.params["velocity_range"], "velocity_range", env)

  def __call__(
    self,
    env: "ManagerBasedRlEnv",
    mask: torch.Tensor,
    *,
    pose_range: dict[str, Range],
    velocity_range: dict[str, Range] | None = None,
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    del pose_range, velocity_range  # Resolved at build.
    entity = env.scene[asset.name]
    default = entity.data.default_root_state
    draw = {"generator": env.rng, "device": env.device, "dtype": env.sim.dtype}
    offset = uniform(self._pose_lo, self._pose_hi, (env.num_envs, 6), **draw)
    position = default[:, :3] + offset[:, :3] + env.scene.env_origins
    orientation = quat_mul(default[:, 3:7], quat_from_euler_xyz(offset[:, 3], offset[:, 4], offset[:, 5]))
    if entity.is_fixed_base:
      entity.write_root_pose(torch.cat([position, orientation], -1), mask)
      return
    velocity = default[:, 7:] + uniform(self._vel_lo, self._vel_hi, (env.num_envs, 6), **draw)
    entity.write_root_state(torch.cat([position, orientation, velocity], -1), mask)


class reset_joints_by_offset(ManagerTermBase):
  """Put joints at their default state plus uniform offsets [rad, m] and [rad/s, m/s], inside their soft limits."""

  def __init__(self, cfg: EventTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    for name in ("position_range", "velocity_range"):
      check_range(name, *cfg.params[name])

  def __call__(
    self,
    env: "ManagerBasedRlEnv",
    mask: torch.Tensor,
    *,
    position_range: Range,
    velocity_range: Range,
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    entity = env.scene[asset.name]
    data, ids = entity.data, asset.joint_ids
    draw = {"generator": env.rng, "device": env.device, "dtype": env.sim.dtype}
    position = data.default_joint_pos[:, ids]
    shape = (env.num_envs, position.shape[1])
    limits = data.soft_joint_pos_limits[:, ids]
    position = (position + uniform(*position_range, shape, **draw)).clamp(limits[..., 0], limits[..., 1])
    velocity = data.default_joint_vel[:, ids] + uniform(*velocity_range, shape, **draw)
    entity.write_joint_state(position, velocity, mask=mask, joint_ids=ids)


class push_by_setting_velocity(ManagerTermBase):
  """Add a uniform twist to the root's velocity, world frame; ranges by axis as in `reset_root_state_uniform`.

  Works on state alone, so that a push costs no forward pass of its own.
  """

  _constants = frozenset({"_lo", "_hi"})

  def __init__(self, cfg: EventTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._lo, self._hi = axis_bounds(cfg.params["velocity_range"], "velocity_range", env)
    entity = env.scene[cfg.params["asset"].name]
    if entity.is_fixed_base:
      raise ValueError(f"entity '{entity.name}': its base does not float, so it has no velocity to push")

  def __call__(
    self,
    env: "ManagerBasedRlEnv",
    mask: torch.Tensor,
    *,
    velocity_range: dict[str, Range],
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    del velocity_range  # Resolved at build.
    entity = env.scene[asset.name]
    twist = uniform(self._lo, self._hi, (env.num_envs, 6), generator=env.rng, device=env.device, dtype=env.sim.dtype)
    data = entity.data
    spin = quat_apply(data.root_link_quat_w, data.root_link_ang_vel_b)
    entity.write_root_velocity(torch.cat([data.root_link_lin_vel_w, spin], -1) + twist, mask)


def axis_bounds(
  ranges: dict[str, Range] | None, name: str, env: "ManagerBasedRlEnv"
) -> tuple[torch.Tensor, torch.Tensor]:
  """Lower and upper bounds (1, 6) of ranges by axis; axes left out are (0, 0).

  Raises:
    ValueError: an axis that does not exist, or an inverted range.
  """
  ranges = ranges or {}
  for axis, (lo, hi) in ranges.items():
    if axis not in _AXES:
      raise ValueError(unknown("axis", axis, _AXES, owner=name))
    check_range(f"{name}['{axis}']", lo, hi)
  bounds = torch.tensor([ranges.get(axis, (0.0, 0.0)) for axis in _AXES], device=env.device, dtype=env.sim.dtype)
  return bounds[None, :, 0], bounds[None, :, 1]
