"""Data of an entity: poses, velocities, joints, forces, targets and limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import torch
from mjlab_actuators import Target
from mjlab_core import Index, Stateful, as_index, select

from mjlab_scene.entities.actuation import Actuation
from mjlab_scene.entities.indexing import EntityIndexing
from mjlab_scene.entities.initial_state import InitialState
from mjlab_scene.quantities import FrameQuantities, QuantityCache, Root, cached_quantity, forwarded, rows

if TYPE_CHECKING:
  from mjlab_sim import Simulation


class EntityData(Stateful):
  """State of an entity in every world, and the quantities that follow from it.

  "link" is a body's frame at its origin, "com" its inertial frame at its centre of mass. Velocities are linear, then
  angular. "w" is the world frame, "b" the frame of the root link. Quaternions are (w, x, y, z). Constants have one row
  for all worlds.

  State (joints, floating and mocap bases, wrenches) are views of the simulation's memory wherever its layout allows:
  always current, and changed by the next step, so clone what must outlive it. All else is computed when it is first
  read, once per state. Write only to targets and `encoder_bias`.

  Args:
    sim: The simulation.
    indexing: Places of the entity's elements.
    initial: State that the entity is reset to.
    actuation: Targets of the entity.
    soft_joint_pos_limit_factor: Share of the range of a joint that its soft limits span.
  """

  joint_pos_target: torch.Tensor
  """Position targets of the joints, (num_envs, num_joint_pos) [rad or m]."""
  joint_vel_target: torch.Tensor
  """Velocity targets of the joints, (num_envs, num_joint_vel) [rad/s or m/s]."""
  joint_effort_target: torch.Tensor
  """Effort targets of the joints, (num_envs, num_joint_vel) [N m or N]."""
  tendon_len_target: torch.Tensor
  """Length targets of the tendons, (num_envs, num_tendons) [m or rad]."""
  tendon_vel_target: torch.Tensor
  """Velocity targets of the tendons, (num_envs, num_tendons) [m/s or rad/s]."""
  tendon_effort_target: torch.Tensor
  """Effort targets along the tendons, (num_envs, num_tendons) [N or N m]."""
  site_pos_target: torch.Tensor
  """Position targets of the sites from their reference site, along the gear, (num_envs, num_sites) [m or rad]."""
  site_vel_target: torch.Tensor
  """Velocity targets of the sites along the gear, (num_envs, num_sites) [m/s or rad/s]."""
  site_effort_target: torch.Tensor
  """Effort targets of the sites, times the gear their wrench, (num_envs, num_sites) [N or N m]."""
  encoder_bias: torch.Tensor
  """Offset that the encoders add to each joint position, (num_envs, num_joint_pos) [rad or m]."""
  default_root_state: torch.Tensor
  """Initial root pose, and velocity if the base floats, from the world's origin, (1, 13 or 7) [m, 1, m/s, rad/s]."""
  default_joint_pos: torch.Tensor
  """Initial joint positions, (1, num_joint_pos) [rad or m]."""
  default_joint_vel: torch.Tensor
  """Initial joint velocities, (1, num_joint_vel) [rad/s or m/s]."""
  default_joint_pos_limits: torch.Tensor
  """Compiled lower and upper position limit, infinite where there is none, (1, num_joint_pos, 2) [rad or m]."""
  joint_vel_limits: torch.Tensor
  """Top speed of each joint that its actuator states, infinite where none does, (1, num_joint_vel) [rad/s or m/s]."""
  forward_vec_b: torch.Tensor
  """Axis of the root link that is called forward, root link frame, (1, 3) [1]."""

  # Root

  root_link_pose_w = forwarded("_root.pose")
  """Pose of the root link, world frame, (num_envs, 7) [m, 1]."""
  root_link_pos_w = forwarded("_root.pos")
  """Position of the root link's origin, world frame, (num_envs, 3) [m]."""
  root_link_quat_w = forwarded("_root.quat")
  """Orientation of the root link in the world, unit quaternion, (num_envs, 4) [1]."""
  root_link_vel_w = forwarded("_root.vel")
  """Velocity of the root link at its origin, world frame, (num_envs, 6) [m/s, rad/s]."""
  root_link_lin_vel_w = forwarded("_root.lin_vel")
  """Linear velocity of the root link at its origin, world frame, (num_envs, 3) [m/s]."""
  root_link_ang_vel_w = forwarded("_root.ang_vel")
  """Angular velocity of the root link, world frame, (num_envs, 3) [rad/s]."""
  root_link_lin_vel_b = forwarded("_root.lin_vel_b")
  """Linear velocity of the root link at its origin, root link frame, (num_envs, 3) [m/s]."""
  root_link_ang_vel_b = forwarded("_root.ang_vel_b")
  """Angular velocity of the root link, root link frame, (num_envs, 3) [rad/s]."""
  root_com_pose_w = forwarded("_root.com.pose")
  """Pose of the root body's inertial frame, world frame, (num_envs, 7) [m, 1]."""
  root_com_pos_w = forwarded("_root.com.pos")
  """Position of the root body's centre of mass, world frame, (num_envs, 3) [m]."""
  root_com_quat_w = forwarded("_root.com.quat")
  """Orientation of the root body's inertial frame in the world, (num_envs, 4) [1]."""
  root_com_vel_w = forwarded("_root.com.vel")
  """Velocity of the root body at its centre of mass, world frame, (num_envs, 6) [m/s, rad/s]."""
  root_com_lin_vel_w = forwarded("_root.com.lin_vel")
  """Linear velocity of the root body at its centre of mass, world frame, (num_envs, 3) [m/s]."""
  root_com_ang_vel_w = forwarded("_root.ang_vel")
  """Angular velocity of the root body, world frame, (num_envs, 3) [rad/s]."""
  root_com_lin_vel_b = forwarded("_root.com_lin_vel_b")
  """Linear velocity of the root body at its centre of mass, root link frame, (num_envs, 3) [m/s]."""
  root_com_ang_vel_b = forwarded("_root.ang_vel_b")
  """Angular velocity of the root body, root link frame, (num_envs, 3) [rad/s]."""
  projected_gravity_b = forwarded("_root.projected_gravity")
  """Unit vector along gravity, root link frame, (num_envs, 3) [1]."""
  gravity_vec_w = forwarded("_root.gravity")
  """Unit vector along the simulation's gravity, down if there is none, world frame, (1, 3) [1].

  One row per world once gravity is randomised."""
  heading_w = forwarded("_root.heading")
  """Angle from the world's x axis to the root link's, about the vertical, (num_envs,) [rad]."""

  # Bodies, geoms and sites

  body_link_pose_w = forwarded("_links.pose")
  """Pose of each link, world frame, (num_envs, num_bodies, 7) [m, 1]."""
  body_link_pos_w = forwarded("_links.pos")
  """Position of each link's origin, world frame, (num_envs, num_bodies, 3) [m]."""
  body_link_quat_w = forwarded("_links.quat")
  """Orientation of each link in the world, (num_envs, num_bodies, 4) [1]."""
  body_link_vel_w = forwarded("_links.vel")
  """Velocity of each link at its origin, world frame, (num_envs, num_bodies, 6) [m/s, rad/s]."""
  body_link_lin_vel_w = forwarded("_links.lin_vel")
  """Linear velocity of each link at its origin, world frame, (num_envs, num_bodies, 3) [m/s]."""
  body_link_ang_vel_w = forwarded("_links.ang_vel")
  """Angular velocity of each link, world frame, (num_envs, num_bodies, 3) [rad/s]."""
  body_com_pose_w = forwarded("_coms.pose")
  """Pose of each body's inertial frame, world frame, (num_envs, num_bodies, 7) [m, 1]."""
  body_com_pos_w = forwarded("_coms.pos")
  """Position of each body's centre of mass, world frame, (num_envs, num_bodies, 3) [m]."""
  body_com_quat_w = forwarded("_coms.quat")
  """Orientation of each body's inertial frame in the world, (num_envs, num_bodies, 4) [1]."""
  body_com_vel_w = forwarded("_coms.vel")
  """Velocity of each body at its centre of mass, world frame, (num_envs, num_bodies, 6) [m/s, rad/s]."""
  body_com_lin_vel_w = forwarded("_coms.lin_vel")
  """Linear velocity of each body at its centre of mass, world frame, (num_envs, num_bodies, 3) [m/s]."""
  body_com_ang_vel_w = forwarded("_coms.ang_vel")
  """Angular velocity of each body, world frame, (num_envs, num_bodies, 3) [rad/s]."""
  geom_pose_w = forwarded("_geoms.pose")
  """Pose of each geom, world frame, (num_envs, num_geoms, 7) [m, 1]."""
  geom_pos_w = forwarded("_geoms.pos")
  """Position of each geom, world frame, (num_envs, num_geoms, 3) [m]."""
  geom_quat_w = forwarded("_geoms.quat")
  """Orientation of each geom in the world, (num_envs, num_geoms, 4) [1]."""
  geom_vel_w = forwarded("_geoms.vel")
  """Velocity of each geom at its centre, world frame, (num_envs, num_geoms, 6) [m/s, rad/s]."""
  geom_lin_vel_w = forwarded("_geoms.lin_vel")
  """Linear velocity of each geom at its centre, world frame, (num_envs, num_geoms, 3) [m/s]."""
  geom_ang_vel_w = forwarded("_geoms.ang_vel")
  """Angular velocity of each geom, world frame, (num_envs, num_geoms, 3) [rad/s]."""
  site_pose_w = forwarded("_sites.pose")
  """Pose of each site, world frame, (num_envs, num_sites, 7) [m, 1]."""
  site_pos_w = forwarded("_sites.pos")
  """Position of each site, world frame, (num_envs, num_sites, 3) [m]."""
  site_quat_w = forwarded("_sites.quat")
  """Orientation of each site in the world, (num_envs, num_sites, 4) [1]."""
  site_vel_w = forwarded("_sites.vel")
  """Velocity of each site, world frame, (num_envs, num_sites, 6) [m/s, rad/s]."""
  site_lin_vel_w = forwarded("_sites.lin_vel")
  """Linear velocity of each site, world frame, (num_envs, num_sites, 3) [m/s]."""
  site_ang_vel_w = forwarded("_sites.ang_vel")
  """Angular velocity of each site, world frame, (num_envs, num_sites, 3) [rad/s]."""

  def __init__(
    self,
    sim: Simulation,
    indexing: EntityIndexing,
    initial: InitialState,
    actuation: Actuation,
    soft_joint_pos_limit_factor: float,
    encoder_bias: Mapping[str, float],
  ) -> None:
    self.num_envs, self.device = sim.num_envs, sim.device
    self.cache = QuantityCache(sim)
    self._sim, self._ix = sim, indexing
    self._soft_factor = soft_joint_pos_limit_factor
    self._root = Root(sim, indexing)
    self._links = FrameQuantities(sim, indexing.frames["body"], "xpos")
    self._coms = FrameQuantities(sim, indexing.frames["body"], "xipos", "body_iquat")
    self._geoms = FrameQuantities(sim, indexing.frames["geom"], "geom_xpos", "geom_quat")
    self._sites = FrameQuantities(sim, indexing.frames["site"], "site_xpos", "site_quat")

    for (kind, quantity), targets in actuation.views.items():
      position = "len" if kind == "tendon" else "pos"
      short = {"position": position, "velocity": "vel", "effort": "effort"}[quantity]
      setattr(self, f"{kind}_{short}_target", targets)

    def constant(row: Sequence[float]) -> torch.Tensor:
      return torch.tensor([row], dtype=sim.dtype, device=sim.device)

    velocity = initial.root_velocity if indexing.root_q is not None else []
    joints = indexing.names["joint"]
    self.default_root_state = constant([*initial.root_pose, *velocity])
    self.default_joint_pos = constant([x for name in joints for x in initial.joint_pos[name]])
    self.default_joint_vel = constant([x for name in joints for x in initial.joint_vel[name]])
    limits = actuation.actuators.velocity_limits
    self.joint_vel_limits = constant(
      [limits.get(Target("joint", name), np.inf) for name in joints for _ in initial.joint_vel[name]]
    )
    self.forward_vec_b = constant([1.0, 0.0, 0.0])
    bias = constant([encoder_bias.get(name, 0.0) for name in joints for _ in initial.joint_pos[name]])
    self.encoder_bias = self.state((bias.shape[1],), fill=bias, dtype=sim.dtype)
    self._limited, self._limit_joint = _limits(sim.mj_model, indexing, sim.device)
    self.default_joint_pos_limits = self._limit_of(sim.default_field("jnt_range"))
    self._default_soft_limits = self._soften(self.default_joint_pos_limits)
    self._descendants = torch.as_tensor(_descendants(sim.mj_model, indexing), dtype=sim.dtype, device=sim.device)

  # Joints, tendons and actuators

  @property
  def joint_pos(self) -> torch.Tensor:
    """Position of each joint, a quaternion for a ball joint, (num_envs, num_joint_pos) [rad or m]."""
    return select(self._sim.data.qpos, self._ix.joint_q)

  @property
  def joint_pos_biased(self) -> torch.Tensor:
    """Position of each joint as its encoder reports it, (num_envs, num_joint_pos) [rad or m]."""
    return self.joint_pos + self.encoder_bias

  @property
  def joint_vel(self) -> torch.Tensor:
    """Velocity of each joint, (num_envs, num_joint_vel) [rad/s or m/s]."""
    return select(self._sim.data.qvel, self._ix.joint_v)

  @cached_quantity
  def joint_acc(self) -> torch.Tensor:
    """Acceleration of each joint in the substep just done, (num_envs, num_joint_vel) [rad/s^2 or m/s^2]."""
    return select(self._sim.data.qacc, self._ix.joint_v)

  @property
  def joint_pos_limits(self) -> torch.Tensor:
    """Lower and upper position limit, infinite where there is none, (1, num_joint_pos, 2) [rad or m].

    One row per world once limits are randomised.
    """
    return self._limits if self._sim.is_expanded("jnt_range") else self.default_joint_pos_limits

  @property
  def soft_joint_pos_limits(self) -> torch.Tensor:
    """Limits narrowed about their middle by the soft limit factor, (1, num_joint_pos, 2) [rad or m].

    One row per world once limits are randomised.
    """
    return self._soft_limits if self._sim.is_expanded("jnt_range") else self._default_soft_limits

  @cached_quantity
  def _limits(self) -> torch.Tensor:
    return self._limit_of(self._sim.model.jnt_range)

  @cached_quantity
  def _soft_limits(self) -> torch.Tensor:
    return self._soften(self._limits)

  @cached_quantity
  def tendon_len(self) -> torch.Tensor:
    """Length of each tendon, (num_envs, num_tendons) [m or rad]."""
    return select(self._sim.data.ten_length, self._ix.index["tendon"])

  @cached_quantity
  def tendon_vel(self) -> torch.Tensor:
    """Rate of change of each tendon's length, (num_envs, num_tendons) [m/s or rad/s]."""
    return select(self._sim.data.ten_velocity, self._ix.index["tendon"])

  @cached_quantity
  def actuator_force(self) -> torch.Tensor:
    """Scalar output of each actuator in the substep just done, (num_envs, num_actuators) [N or N m]."""
    return select(self._sim.data.actuator_force, self._ix.index["actuator"])

  @cached_quantity
  def qfrc_actuator(self) -> torch.Tensor:
    """Force of all actuators on each joint in the substep just done, (num_envs, num_joint_vel) [N m or N]."""
    return select(self._sim.data.qfrc_actuator, self._ix.joint_v)

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

  @cached_quantity
  def qfrc_external(self) -> torch.Tensor:
    """Force on each joint of the wrenches applied to the entity's bodies, (num_envs, num_joint_vel) [N m or N]."""
    force, torque = self.body_external_force, self.body_external_torque
    arm = self.body_com_pos_w - rows(self._sim.data.subtree_com, self._ix.frames["body"].trees)
    # About the tree's centre of mass, where MuJoCo keeps its motion axes (rotation, then translation).
    wrench = torch.cat((torque + torch.linalg.cross(arm, force), force), dim=-1)
    carried = torch.einsum("vb,nbk->nvk", self._descendants, wrench)
    return (select(self._sim.data.cdof, self._ix.joint_v) * carried).sum(-1)

  def _soften(self, limits: torch.Tensor) -> torch.Tensor:
    low, high = limits.unbind(-1)
    inset = (0.5 * (1.0 - self._soft_factor)) * (high - low)
    # Infinite limits have no middle.
    return torch.where(self._limited.unsqueeze(-1), torch.stack((low + inset, high - inset), dim=-1), limits)

  def _limit_of(self, ranges: torch.Tensor) -> torch.Tensor:
    limits = select(ranges, self._limit_joint)
    unlimited = torch.full_like(limits[:1], float("inf"))
    unlimited[..., 0] = -float("inf")
    return torch.where(self._limited.unsqueeze(-1), limits, unlimited)


def _limits(model: mujoco.MjModel, ix: EntityIndexing, device: torch.device) -> tuple[torch.Tensor, Index]:
  """Return which position columns are limited, (1, num_joint_pos), and the joint of each column."""
  joints = np.repeat(ix.ids["joint"], np.array([len(columns) for columns in ix.q_of_joint], dtype=int))
  limited = model.jnt_limited[joints].astype(bool) & (model.jnt_type[joints] != mujoco.mjtJoint.mjJNT_BALL)
  return torch.as_tensor(limited[None], device=device), as_index(joints, device)


def _descendants(model: mujoco.MjModel, ix: EntityIndexing) -> np.ndarray:
  """Return 1 where a joint's degree of freedom moves a body of the entity, (num_joint_vel, num_bodies)."""
  carried = np.eye(model.nbody)
  for body in range(1, model.nbody):
    carried[body] += carried[model.body_parentid[body]]
  joints = np.repeat(ix.ids["joint"], np.array([len(columns) for columns in ix.v_of_joint], dtype=int))
  return carried[ix.ids["body"]][:, model.jnt_bodyid[joints]].T
