"""What can be known about an entity: poses, velocities, joints, forces, set-points and limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import torch
from mjlab_core.rotations import quat_mul
from mjlab_core.state import Stateful

from mjlab_scene.indexing import EntityIndexing, Index, select
from mjlab_scene.initial_state import InitialState
from mjlab_scene.quantities import QuantityCache, cached_quantity

if TYPE_CHECKING:
  from mjlab_sim import Simulation


class EntityData(Stateful):
  """The state of an entity in every world, and what follows from it.

  "link" is a body's frame at its origin, "com" its inertial frame at its centre of mass. Velocities are linear, then
  angular. "w" is the world frame, "b" the frame of the root link. Quaternions are (w, x, y, z). Constants have one row
  for all worlds.

  State (joints, floating and mocap bases, wrenches) are views of the simulation's memory wherever its layout allows:
  always current, and changed by the next step, so clone what must outlive it. All else is computed when first asked
  for and once per state. Nothing here is to be written to but the set-points and `encoder_bias`.
  """

  _constants = frozenset(
    {
      "default_root_state",
      "default_joint_pos",
      "default_joint_vel",
      "default_joint_pos_limits",
      "forward_vec_b",
      "_default_gravity",
      "_default_soft_limits",
      "_descendants",
      "_limited",
      "_zero_velocity",
    }
  )

  joint_pos_target: torch.Tensor
  """Position set-points of the joints, (num_envs, num_joint_pos) [rad or m]."""
  joint_vel_target: torch.Tensor
  """Velocity set-points of the joints, (num_envs, num_joint_vel) [rad/s or m/s]."""
  joint_effort_target: torch.Tensor
  """Effort set-points of the joints, (num_envs, num_joint_vel) [N m or N]."""
  encoder_bias: torch.Tensor
  """What the encoders add to each joint position, (num_envs, num_joint_pos) [rad or m]."""
  default_root_state: torch.Tensor
  """Initial pose, and velocity if the base floats, relative to the world's origin, (1, num_root_state) [m, 1, m/s, rad/s]."""
  default_joint_pos: torch.Tensor
  """Initial joint positions, (1, num_joint_pos) [rad or m]."""
  default_joint_vel: torch.Tensor
  """Initial joint velocities, (1, num_joint_vel) [rad/s or m/s]."""

  default_joint_pos_limits: torch.Tensor
  """Compiled lower and upper position limit, infinite where there is none, (1, num_joint_pos, 2) [rad or m]."""
  forward_vec_b: torch.Tensor
  """Axis of the root link that is called forward, root link frame, (1, 3) [1]."""

  def __init__(
    self, sim: Simulation, indexing: EntityIndexing, initial: InitialState, soft_joint_pos_limit_factor: float
  ) -> None:
    self.num_envs = sim.num_envs
    self.cache = QuantityCache(sim)
    self._sim = sim
    self._ix = indexing
    self._soft_factor = soft_joint_pos_limit_factor
    self._root = slice(indexing.root_body, indexing.root_body + 1)
    self._views = _StateViews(sim, indexing)

    def constant(rows: list[float]) -> torch.Tensor:
      return torch.tensor([rows], dtype=sim.dtype, device=sim.device)

    floating = indexing.root_q is not None
    self.default_root_state = constant([*initial.root_pose, *(initial.root_velocity if floating else [])])
    names = indexing.names["joint"]
    self.default_joint_pos = constant([x for name in names for x in initial.joint_pos[name]])
    self.default_joint_vel = constant([x for name in names for x in initial.joint_vel[name]])
    self._zero_velocity = torch.zeros((sim.num_envs, 6), dtype=sim.dtype, device=sim.device)
    self._straight_down = _points_straight_down(sim.mj_model.opt.gravity)
    self._default_gravity = _direction(sim.default_field("opt.gravity"))
    self.forward_vec_b = constant([1.0, 0.0, 0.0])
    self._limited, self._limit_joint = _limits(sim.mj_model, indexing, sim.device)
    self.default_joint_pos_limits = self._limit_of(sim.default_field("jnt_range"))
    self._default_soft_limits = self._soften(self.default_joint_pos_limits)
    self._descendants = _descendants(sim.mj_model, indexing, sim.dtype, sim.device)

    num_v = self.default_joint_vel.shape[1]
    self.joint_pos_target = self.default_joint_pos.repeat(sim.num_envs, 1)
    self.joint_vel_target = torch.zeros((sim.num_envs, num_v), dtype=sim.dtype, device=sim.device)
    self.joint_effort_target = torch.zeros_like(self.joint_vel_target)
    self.encoder_bias = torch.zeros_like(self.joint_pos_target)

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

  # Joints, tendons and actuators

  @property
  def joint_pos(self) -> torch.Tensor:
    """Position of each joint, a quaternion for a ball joint, (num_envs, num_joint_pos) [rad or m]."""
    return self._views.joint_pos if self._views.joint_pos is not None else select(self._sim.data.qpos, self._ix.joint_q)

  @property
  def joint_pos_biased(self) -> torch.Tensor:
    """Position of each joint as its encoder reports it, (num_envs, num_joint_pos) [rad or m]."""
    return self.joint_pos + self.encoder_bias

  @property
  def joint_vel(self) -> torch.Tensor:
    """Velocity of each joint, (num_envs, num_joint_vel) [rad/s or m/s]."""
    return self._views.joint_vel if self._views.joint_vel is not None else select(self._sim.data.qvel, self._ix.joint_v)

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

  @cached_quantity
  def qfrc_external(self) -> torch.Tensor:
    """Force on each joint of the wrenches applied to the entity's bodies, (num_envs, num_joint_vel) [N m or N]."""
    force, torque = self.body_external_force, self.body_external_torque
    arm = self.body_com_pos_w - select(self._sim.data.subtree_com, self._ix.root_of_body)
    # About the tree's centre of mass, where MuJoCo keeps its motion axes (rotation, then translation).
    wrench = torch.cat((torque + torch.linalg.cross(arm, force), force), dim=-1)
    carried = torch.einsum("vb,nbk->nvk", self._descendants, wrench)
    return (select(self._sim.data.cdof, self._ix.joint_v) * carried).sum(-1)

  # Parts of the above

  @cached_quantity
  def _root_xmat(self) -> torch.Tensor:
    return self._sim.data.xmat[:, self._ix.root_body]

  def _into_root(self, vector: torch.Tensor) -> torch.Tensor:
    return (self._root_xmat * vector.unsqueeze(-1)).sum(-2)

  def _velocity_at(self, point: torch.Tensor, body: Index, tree: Index) -> torch.Tensor:
    """Linear velocity of points fixed to bodies: MuJoCo gives each body's at the centre of mass of its tree."""
    twist = select(self._sim.data.cvel, body)
    arm = point - select(self._sim.data.subtree_com, tree)
    return twist[..., 3:] + torch.linalg.cross(twist[..., :3], arm)

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


class _StateViews:
  """Views of the simulation's state; its memory never moves. None where the layout allows no view."""

  def __init__(self, sim: Simulation, ix: EntityIndexing) -> None:
    def view(array: torch.Tensor, columns: Index) -> torch.Tensor | None:
      return array[:, columns] if isinstance(columns, slice) else None

    self.joint_pos = view(sim.data.qpos, ix.joint_q)
    self.joint_vel = view(sim.data.qvel, ix.joint_v)
    self.root_pose: torch.Tensor | None = None
    self.root_lin_vel_w: torch.Tensor | None = None
    self.root_ang_vel_b: torch.Tensor | None = None
    if ix.root_q is not None and ix.root_v is not None:
      self.root_pose = sim.data.qpos[:, ix.root_q]
      self.root_pos, self.root_quat = self.root_pose[:, :3], self.root_pose[:, 3:]
      velocity = sim.data.qvel[:, ix.root_v]
      self.root_lin_vel_w, self.root_ang_vel_b = velocity[:, :3], velocity[:, 3:]
    else:
      assert ix.mocap is not None
      self.root_pos, self.root_quat = sim.data.mocap_pos[:, ix.mocap], sim.data.mocap_quat[:, ix.mocap]


def _direction(gravity: torch.Tensor) -> torch.Tensor:
  norm = torch.linalg.vector_norm(gravity, dim=-1, keepdim=True)
  down = torch.zeros_like(gravity)
  down[:, 2] = -1.0
  return torch.where(norm > 0, gravity / norm.clamp_min(1e-12), down)


def _points_straight_down(gravity: object) -> bool:
  x, y, z = (float(value) for value in gravity)  # pyright: ignore[reportGeneralTypeIssues]
  return x == 0.0 and y == 0.0 and z <= 0.0


def _limits(model: mujoco.MjModel, ix: EntityIndexing, device: torch.device) -> tuple[torch.Tensor, Index]:
  """Which position columns are limited, (1, num_joint_pos), and the joint of each column."""
  joints = [joint for joint, columns in zip(ix.ids["joint"], ix.q_of_joint, strict=True) for _ in columns]
  limited = [bool(model.jnt_limited[j]) and model.jnt_type[j] != mujoco.mjtJoint.mjJNT_BALL for j in joints]
  if ix.scalar_joints:
    return torch.tensor([limited], dtype=torch.bool, device=device), ix.index["joint"]
  return (
    torch.tensor([limited], dtype=torch.bool, device=device),
    torch.tensor([int(joint) for joint in joints], dtype=torch.long, device=device),
  )


def _descendants(model: mujoco.MjModel, ix: EntityIndexing, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
  """1 where a joint's degree of freedom moves a body of the entity, (num_joint_vel, num_bodies)."""
  dofs = [
    int(model.jnt_bodyid[joint]) for joint, columns in zip(ix.ids["joint"], ix.v_of_joint, strict=True) for _ in columns
  ]
  moved = torch.zeros((len(dofs), len(ix.ids["body"])), dtype=dtype)
  for column, body in enumerate(ix.ids["body"]):
    ancestors = {int(body)}
    while body != 0:
      body = model.body_parentid[body]
      ancestors.add(int(body))
    for row, owner in enumerate(dofs):
      moved[row, column] = float(owner in ancestors)
  return moved.to(device)
