"""What can be known about an entity: poses, velocities, joints, forces, set-points and limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import torch

from mjlab_scene.frame_quantities import FrameQuantities
from mjlab_scene.indexing import EntityIndexing, Index, select
from mjlab_scene.initial_state import InitialState
from mjlab_scene.quantities import QuantityCache, cached_quantity
from mjlab_scene.root_quantities import RootQuantities
from mjlab_scene.state_views import StateViews

if TYPE_CHECKING:
  from mjlab_sim import Simulation


class EntityData(RootQuantities, FrameQuantities):
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
      "_default_soft_limits",
      "_descendants",
      "_limited",
      "_limit_joint",
    }
  )

  joint_pos_target: torch.Tensor
  """Position set-points of the joints, (num_envs, num_joint_pos) [rad or m]."""
  joint_vel_target: torch.Tensor
  """Velocity set-points of the joints, (num_envs, num_joint_vel) [rad/s or m/s]."""
  joint_effort_target: torch.Tensor
  """Effort set-points of the joints, (num_envs, num_joint_vel) [N m or N]."""
  tendon_len_target: torch.Tensor
  """Length set-points of the tendons, (num_envs, num_tendons) [m or rad]."""
  tendon_vel_target: torch.Tensor
  """Velocity set-points of the tendons, (num_envs, num_tendons) [m/s or rad/s]."""
  tendon_effort_target: torch.Tensor
  """Effort set-points along the tendons, (num_envs, num_tendons) [N or N m]."""
  site_pos_target: torch.Tensor
  """Position set-points of the sites from their reference site, along the gear, (num_envs, num_sites) [m or rad]."""
  site_vel_target: torch.Tensor
  """Velocity set-points of the sites along the gear, (num_envs, num_sites) [m/s or rad/s]."""
  site_effort_target: torch.Tensor
  """Effort set-points of the sites, times the gear their wrench, (num_envs, num_sites) [N or N m]."""
  encoder_bias: torch.Tensor
  """What the encoders add to each joint position, (num_envs, num_joint_pos) [rad or m]."""
  default_root_state: torch.Tensor
  """Initial root pose, and velocity if the base floats, from the world's origin, (1, 13 or 7) [m, 1, m/s, rad/s]."""
  default_joint_pos: torch.Tensor
  """Initial joint positions, (1, num_joint_pos) [rad or m]."""
  default_joint_vel: torch.Tensor
  """Initial joint velocities, (1, num_joint_vel) [rad/s or m/s]."""

  default_joint_pos_limits: torch.Tensor
  """Compiled lower and upper position limit, infinite where there is none, (1, num_joint_pos, 2) [rad or m]."""

  def __init__(
    self, sim: Simulation, indexing: EntityIndexing, initial: InitialState, soft_joint_pos_limit_factor: float
  ) -> None:
    self.num_envs = sim.num_envs
    self.cache = QuantityCache(sim)
    self._sim = sim
    self._ix = indexing
    self._soft_factor = soft_joint_pos_limit_factor
    self._views = StateViews(sim, indexing)
    self._initialize_root()

    def constant(rows: list[float]) -> torch.Tensor:
      return torch.tensor([rows], dtype=sim.dtype, device=sim.device)

    floating = indexing.root_q is not None
    self.default_root_state = constant([*initial.root_pose, *(initial.root_velocity if floating else [])])
    names = indexing.names["joint"]
    self.default_joint_pos = constant([x for name in names for x in initial.joint_pos[name]])
    self.default_joint_vel = constant([x for name in names for x in initial.joint_vel[name]])
    self._limited, self._limit_joint = _limits(sim.mj_model, indexing, sim.device)
    self.default_joint_pos_limits = self._limit_of(sim.default_field("jnt_range"))
    self._default_soft_limits = self._soften(self.default_joint_pos_limits)
    self._descendants = _descendants(sim.mj_model, indexing, sim.dtype, sim.device)

    num_v = self.default_joint_vel.shape[1]
    self.joint_pos_target = self.default_joint_pos.repeat(sim.num_envs, 1)
    self.joint_vel_target = torch.zeros((sim.num_envs, num_v), dtype=sim.dtype, device=sim.device)
    self.joint_effort_target = torch.zeros_like(self.joint_vel_target)
    num_tendons, num_sites = len(indexing.names["tendon"]), len(indexing.names["site"])
    for kind, width, position in (("tendon", num_tendons, "len"), ("site", num_sites, "pos")):
      for quantity in (position, "vel", "effort"):
        zeros = torch.zeros((sim.num_envs, width), dtype=sim.dtype, device=sim.device)
        setattr(self, f"{kind}_{quantity}_target", zeros)
    self.encoder_bias = torch.zeros_like(self.joint_pos_target)

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
