"""Poses and velocities of all bodies, geoms and sites of an entity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from mjlab_core.rotations import quat_mul
from mjlab_core.state import Stateful

from mjlab_scene.indexing import EntityIndexing, Index, select
from mjlab_scene.quantities import QuantityCache, cached_quantity

if TYPE_CHECKING:
  from mjlab_sim import Simulation


class FrameQuantities(Stateful):
  """The part of `EntityData` that follows from MuJoCo's kinematics, for every frame of the entity at once."""

  cache: QuantityCache
  _sim: Simulation
  _ix: EntityIndexing

  # Bodies

  @cached_quantity
  def body_link_pose_w(self) -> torch.Tensor:
    """Pose of each link, world frame, (num_envs, num_bodies, 7) [m, 1]."""
    return torch.cat((self.body_link_pos_w, self.body_link_quat_w), dim=-1)

  @cached_quantity
  def body_link_pos_w(self) -> torch.Tensor:
    """Position of each link's origin, world frame, (num_envs, num_bodies, 3) [m]."""
    return select(self._sim.data.xpos, self._ix.index["body"])

  @cached_quantity
  def body_link_quat_w(self) -> torch.Tensor:
    """Orientation of each link in the world, (num_envs, num_bodies, 4) [1]."""
    return select(self._sim.data.xquat, self._ix.index["body"])

  @cached_quantity
  def body_link_vel_w(self) -> torch.Tensor:
    """Velocity of each link at its origin, world frame, (num_envs, num_bodies, 6) [m/s, rad/s]."""
    return torch.cat((self.body_link_lin_vel_w, self.body_link_ang_vel_w), dim=-1)

  @cached_quantity
  def body_link_lin_vel_w(self) -> torch.Tensor:
    """Linear velocity of each link at its origin, world frame, (num_envs, num_bodies, 3) [m/s]."""
    return self._velocity_at(self.body_link_pos_w, self._ix.index["body"], self._ix.root_of_body)

  @cached_quantity
  def body_link_ang_vel_w(self) -> torch.Tensor:
    """Angular velocity of each link, world frame, (num_envs, num_bodies, 3) [rad/s]."""
    return select(self._sim.data.cvel, self._ix.index["body"])[..., :3]

  @cached_quantity
  def body_com_pose_w(self) -> torch.Tensor:
    """Pose of each body's inertial frame, world frame, (num_envs, num_bodies, 7) [m, 1]."""
    return torch.cat((self.body_com_pos_w, self.body_com_quat_w), dim=-1)

  @cached_quantity
  def body_com_pos_w(self) -> torch.Tensor:
    """Position of each body's centre of mass, world frame, (num_envs, num_bodies, 3) [m]."""
    return select(self._sim.data.xipos, self._ix.index["body"])

  @cached_quantity
  def body_com_quat_w(self) -> torch.Tensor:
    """Orientation of each body's inertial frame in the world, (num_envs, num_bodies, 4) [1]."""
    return quat_mul(self.body_link_quat_w, select(self._sim.model.body_iquat, self._ix.index["body"]))

  @cached_quantity
  def body_com_vel_w(self) -> torch.Tensor:
    """Velocity of each body at its centre of mass, world frame, (num_envs, num_bodies, 6) [m/s, rad/s]."""
    return torch.cat((self.body_com_lin_vel_w, self.body_com_ang_vel_w), dim=-1)

  @cached_quantity
  def body_com_lin_vel_w(self) -> torch.Tensor:
    """Linear velocity of each body at its centre of mass, world frame, (num_envs, num_bodies, 3) [m/s]."""
    return self._velocity_at(self.body_com_pos_w, self._ix.index["body"], self._ix.root_of_body)

  @property
  def body_com_ang_vel_w(self) -> torch.Tensor:
    """Angular velocity of each body, world frame, (num_envs, num_bodies, 3) [rad/s]."""
    return self.body_link_ang_vel_w

  @property
  def body_external_wrench(self) -> torch.Tensor:
    """Applied force and torque on each body at its centre of mass, world frame, (num_envs, num_bodies, 6) [N, N m]."""
    return select(self._sim.data.xfrc_applied, self._ix.index["body"])

  @property
  def body_external_force(self) -> torch.Tensor:
    """Applied force on each body at its centre of mass, world frame, (num_envs, num_bodies, 3) [N]."""
    return self.body_external_wrench[..., :3]

  @property
  def body_external_torque(self) -> torch.Tensor:
    """Applied torque on each body, world frame, (num_envs, num_bodies, 3) [N m]."""
    return self.body_external_wrench[..., 3:]

  # Geoms and sites

  @cached_quantity
  def geom_pose_w(self) -> torch.Tensor:
    """Pose of each geom, world frame, (num_envs, num_geoms, 7) [m, 1]."""
    return torch.cat((self.geom_pos_w, self.geom_quat_w), dim=-1)

  @cached_quantity
  def geom_pos_w(self) -> torch.Tensor:
    """Position of each geom, world frame, (num_envs, num_geoms, 3) [m]."""
    return select(self._sim.data.geom_xpos, self._ix.index["geom"])

  @cached_quantity
  def geom_quat_w(self) -> torch.Tensor:
    """Orientation of each geom in the world, (num_envs, num_geoms, 4) [1]."""
    local = select(self._sim.model.geom_quat, self._ix.index["geom"])
    return quat_mul(select(self._sim.data.xquat, self._ix.geom_body), local)

  @cached_quantity
  def geom_vel_w(self) -> torch.Tensor:
    """Velocity of each geom at its centre, world frame, (num_envs, num_geoms, 6) [m/s, rad/s]."""
    return torch.cat((self.geom_lin_vel_w, self.geom_ang_vel_w), dim=-1)

  @cached_quantity
  def geom_lin_vel_w(self) -> torch.Tensor:
    """Linear velocity of each geom at its centre, world frame, (num_envs, num_geoms, 3) [m/s]."""
    return self._velocity_at(self.geom_pos_w, self._ix.geom_body, self._ix.root_of_geom)

  @cached_quantity
  def geom_ang_vel_w(self) -> torch.Tensor:
    """Angular velocity of each geom, world frame, (num_envs, num_geoms, 3) [rad/s]."""
    return select(self._sim.data.cvel, self._ix.geom_body)[..., :3]

  @cached_quantity
  def site_pose_w(self) -> torch.Tensor:
    """Pose of each site, world frame, (num_envs, num_sites, 7) [m, 1]."""
    return torch.cat((self.site_pos_w, self.site_quat_w), dim=-1)

  @cached_quantity
  def site_pos_w(self) -> torch.Tensor:
    """Position of each site, world frame, (num_envs, num_sites, 3) [m]."""
    return select(self._sim.data.site_xpos, self._ix.index["site"])

  @cached_quantity
  def site_quat_w(self) -> torch.Tensor:
    """Orientation of each site in the world, (num_envs, num_sites, 4) [1]."""
    local = select(self._sim.model.site_quat, self._ix.index["site"])
    return quat_mul(select(self._sim.data.xquat, self._ix.site_body), local)

  @cached_quantity
  def site_vel_w(self) -> torch.Tensor:
    """Velocity of each site, world frame, (num_envs, num_sites, 6) [m/s, rad/s]."""
    return torch.cat((self.site_lin_vel_w, self.site_ang_vel_w), dim=-1)

  @cached_quantity
  def site_lin_vel_w(self) -> torch.Tensor:
    """Linear velocity of each site, world frame, (num_envs, num_sites, 3) [m/s]."""
    return self._velocity_at(self.site_pos_w, self._ix.site_body, self._ix.root_of_site)

  @cached_quantity
  def site_ang_vel_w(self) -> torch.Tensor:
    """Angular velocity of each site, world frame, (num_envs, num_sites, 3) [rad/s]."""
    return select(self._sim.data.cvel, self._ix.site_body)[..., :3]

  def _velocity_at(self, point: torch.Tensor, body: Index, tree: Index) -> torch.Tensor:
    """Linear velocity of points fixed to bodies: MuJoCo gives each body's at the centre of mass of its tree."""
    twist = select(self._sim.data.cvel, body)
    arm = point - select(self._sim.data.subtree_com, tree)
    return twist[..., 3:] + torch.linalg.cross(twist[..., :3], arm)
