"""Pose and velocity of an entity's root, in the world and as its own sensors would see them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from mjlab_core.rotations import quat_mul
from mjlab_core.state import Stateful

from mjlab_scene.indexing import EntityIndexing
from mjlab_scene.quantities import QuantityCache, cached_quantity
from mjlab_scene.state_views import StateViews

if TYPE_CHECKING:
  from mjlab_sim import Simulation


class RootQuantities(Stateful):
  """The part of `EntityData` that is about the root body; a base that does not float has no velocity."""

  _constants = frozenset({"forward_vec_b", "_default_gravity", "_zero_velocity"})

  cache: QuantityCache
  _sim: Simulation
  _ix: EntityIndexing
  _views: StateViews

  forward_vec_b: torch.Tensor
  """Axis of the root link that is called forward, root link frame, (1, 3) [1]."""

  def _initialize_root(self) -> None:
    sim = self._sim
    self.forward_vec_b = torch.tensor([[1.0, 0.0, 0.0]], dtype=sim.dtype, device=sim.device)
    self._zero_velocity = torch.zeros((sim.num_envs, 6), dtype=sim.dtype, device=sim.device)
    x, y, z = sim.mj_model.opt.gravity.tolist()
    self._straight_down = x == 0.0 and y == 0.0 and z <= 0.0
    self._default_gravity = _direction(sim.default_field("opt.gravity"))

  # Root link

  @property
  def root_link_pose_w(self) -> torch.Tensor:
    """Pose of the root link, world frame, (num_envs, 7) [m, 1]."""
    view = self._views.root_pose
    return self._mocap_pose_w if view is None else view

  @cached_quantity
  def _mocap_pose_w(self) -> torch.Tensor:
    return torch.cat((self._views.root_pos, self._views.root_quat), dim=-1)

  @property
  def root_link_pos_w(self) -> torch.Tensor:
    """Position of the root link's origin, world frame, (num_envs, 3) [m]."""
    return self._views.root_pos

  @property
  def root_link_quat_w(self) -> torch.Tensor:
    """Orientation of the root link in the world, unit quaternion, (num_envs, 4) [1]."""
    return self._views.root_quat

  @cached_quantity
  def root_link_vel_w(self) -> torch.Tensor:
    """Velocity of the root link at its origin, world frame, (num_envs, 6) [m/s, rad/s]."""
    return torch.cat((self.root_link_lin_vel_w, self.root_link_ang_vel_w), dim=-1)

  @property
  def root_link_lin_vel_w(self) -> torch.Tensor:
    """Linear velocity of the root link at its origin, world frame, (num_envs, 3) [m/s]."""
    return self._views.root_lin_vel_w if self._views.root_lin_vel_w is not None else self._zero_velocity[:, :3]

  @cached_quantity
  def root_link_ang_vel_w(self) -> torch.Tensor:
    """Angular velocity of the root link, world frame, (num_envs, 3) [rad/s]."""
    if self._views.root_ang_vel_b is None:
      return self._zero_velocity[:, 3:]
    return (self._root_xmat * self._views.root_ang_vel_b.unsqueeze(-2)).sum(-1)

  @cached_quantity
  def root_link_lin_vel_b(self) -> torch.Tensor:
    """Linear velocity of the root link at its origin, root link frame, (num_envs, 3) [m/s]."""
    return self._into_root(self.root_link_lin_vel_w)

  @property
  def root_link_ang_vel_b(self) -> torch.Tensor:
    """Angular velocity of the root link, root link frame, (num_envs, 3) [rad/s]."""
    return self._views.root_ang_vel_b if self._views.root_ang_vel_b is not None else self._zero_velocity[:, 3:]

  @cached_quantity
  def projected_gravity_b(self) -> torch.Tensor:
    """Unit vector along gravity, root link frame, (num_envs, 3) [1]."""
    if self._straight_down and not self._sim.is_expanded("opt.gravity"):
      return -self._root_xmat[:, 2]
    return self._into_root(self.gravity_vec_w)

  @cached_quantity
  def heading_w(self) -> torch.Tensor:
    """Angle from the world's x axis to the root link's, about the vertical, (num_envs,) [rad]."""
    matrix = self._root_xmat
    return torch.atan2(matrix[:, 1, 0], matrix[:, 0, 0])

  @property
  def gravity_vec_w(self) -> torch.Tensor:
    """Unit vector along the simulation's gravity, down if there is none, world frame, (1, 3) [1].

    One row per world once gravity is randomised.
    """
    return self._gravity if self._sim.is_expanded("opt.gravity") else self._default_gravity

  @cached_quantity
  def _gravity(self) -> torch.Tensor:
    return _direction(self._sim.model.opt.gravity)

  # Root centre of mass

  @cached_quantity
  def root_com_pose_w(self) -> torch.Tensor:
    """Pose of the root body's inertial frame, world frame, (num_envs, 7) [m, 1]."""
    return torch.cat((self.root_com_pos_w, self.root_com_quat_w), dim=-1)

  @cached_quantity
  def root_com_pos_w(self) -> torch.Tensor:
    """Position of the root body's centre of mass, world frame, (num_envs, 3) [m]."""
    return self._sim.data.xipos[:, self._ix.root_body]

  @cached_quantity
  def root_com_quat_w(self) -> torch.Tensor:
    """Orientation of the root body's inertial frame in the world, (num_envs, 4) [1]."""
    return quat_mul(self._sim.data.xquat[:, self._ix.root_body], self._sim.model.body_iquat[:, self._ix.root_body])

  @cached_quantity
  def root_com_vel_w(self) -> torch.Tensor:
    """Velocity of the root body at its centre of mass, world frame, (num_envs, 6) [m/s, rad/s]."""
    return torch.cat((self.root_com_lin_vel_w, self.root_com_ang_vel_w), dim=-1)

  @cached_quantity
  def root_com_lin_vel_w(self) -> torch.Tensor:
    """Linear velocity of the root body at its centre of mass, world frame, (num_envs, 3) [m/s]."""
    arm = self._sim.data.xipos[:, self._ix.root_body] - self._sim.data.xpos[:, self._ix.root_body]
    return self.root_link_lin_vel_w + torch.linalg.cross(self.root_link_ang_vel_w, arm)

  @property
  def root_com_ang_vel_w(self) -> torch.Tensor:
    """Angular velocity of the root body, world frame, (num_envs, 3) [rad/s]."""
    return self.root_link_ang_vel_w

  @cached_quantity
  def root_com_lin_vel_b(self) -> torch.Tensor:
    """Linear velocity of the root body at its centre of mass, root link frame, (num_envs, 3) [m/s]."""
    return self._into_root(self.root_com_lin_vel_w)

  @property
  def root_com_ang_vel_b(self) -> torch.Tensor:
    """Angular velocity of the root body, root link frame, (num_envs, 3) [rad/s]."""
    return self.root_link_ang_vel_b

  @cached_quantity
  def _root_xmat(self) -> torch.Tensor:
    return self._sim.data.xmat[:, self._ix.root_body]

  def _into_root(self, vector: torch.Tensor) -> torch.Tensor:
    return (self._root_xmat * vector.unsqueeze(-1)).sum(-2)


def _direction(gravity: torch.Tensor) -> torch.Tensor:
  norm = torch.linalg.vector_norm(gravity, dim=-1, keepdim=True)
  down = torch.zeros_like(gravity)
  down[:, 2] = -1.0
  return torch.where(norm > 0, gravity / norm.clamp_min(1e-12), down)
