"""Forward kinematics of a robot for many frames at once, on any device."""

from collections.abc import Sequence

import mujoco
import numpy as np
import torch
from mjlab_core.errors import MjlabError
from mjlab_core.names import check_name
from mjlab_core.rotations import cross, matrix_from_quat, quat_apply, quat_from_rotvec, quat_mul

from mjlab_motions.motion import Motion
from mjlab_motions.timeline import angular_velocity, derivative

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


class Kinematics:
  """Forward kinematics of one floating tree of a compiled model, batched over frames.

  Args:
    model: Any model. If it has several floating bodies, `prefix` selects one.
    prefix: Prefix of the robot's names in the model, such as "robot/"; names given and returned are without it.
    device: Device of the computation.

  Raises:
    MjlabError: There is not exactly one floating body with that prefix, or the tree has ball joints or bodies with
      several joints.
  """

  def __init__(self, model: mujoco.MjModel, prefix: str = "", device: torch.device | str = "cpu") -> None:
    self.model, self.prefix, self.device = model, prefix, torch.device(device)
    free = [j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
    roots = [int(model.jnt_bodyid[j]) for j in free if model.body(model.jnt_bodyid[j]).name.startswith(prefix)]
    if len(roots) != 1:
      found = ", ".join(model.body(body).name for body in roots) or "none"
      raise MjlabError(f"a motion needs a robot with one floating base; the model has: {found}")
    root = roots[0]
    self._bodies = [b for b in range(root, model.nbody) if model.body_rootid[b] == root]
    self.rows = {body: row for row, body in enumerate(self._bodies)}
    """Row of each body by its id in the model."""
    joints = [j for j in range(model.njnt) if j not in free and int(model.jnt_bodyid[j]) in self.rows]
    if strange := [model.joint(j).name for j in joints if model.jnt_type[j] not in (_HINGE, _SLIDE)]:
      raise MjlabError(f"joint '{strange[0]}' is neither hinge nor slide; motions have no other joints")
    moved = model.jnt_bodyid[joints].tolist()
    if crowded := [model.body(body).name for body in moved if moved.count(body) > 1]:
      raise MjlabError(f"body '{crowded[0]}' has several joints; give each joint a separate body")
    self.joint_ids = joints
    """Ids of the joints in the model."""
    self.joint_names = tuple(self.local_name(model.joint(j).name) for j in joints)
    """Names of the joints in the model's order, without the free one."""
    self.body_names = tuple(self.local_name(model.body(b).name) for b in self._bodies)
    """Names of the bodies in the model's order; the first is the root."""
    self._column = {body: column for column, body in enumerate(moved)}

  @property
  def root_body(self) -> str:
    """Name of the floating body."""
    return self.body_names[0]

  @property
  def ends(self) -> tuple[str, ...]:
    """Bodies without children; their poses determine all others."""
    carrying = {int(self.model.body_parentid[body]) for body in self._bodies}
    return tuple(name for name, body in zip(self.body_names, self._bodies, strict=True) if body not in carrying)

  def poses(
    self, root_pos: torch.Tensor, root_quat: torch.Tensor, joint_pos: torch.Tensor
  ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return position (frames, bodies, 3) [m] and orientation (frames, bodies, 4) of each body's origin in the world.

    Args:
      root_pos: (frames, 3) [m].
      root_quat: (frames, 4), unit.
      joint_pos: In the order of `joint_names`, (frames, joints) [rad or m].
    """
    model, q = self.model, joint_pos
    position, orientation = [root_pos], [root_quat]
    for body in self._bodies[1:]:
      parent = self.rows[int(model.body_parentid[body])]
      pos = position[parent] + quat_apply(orientation[parent], q.new_tensor(model.body_pos[body]))
      quat = quat_mul(orientation[parent], q.new_tensor(model.body_quat[body]))
      if (column := self._column.get(body)) is not None:
        joint = self.joint_ids[column]
        axis, anchor = q.new_tensor(model.jnt_axis[joint]), q.new_tensor(model.jnt_pos[joint])
        moved = q[:, column, None] - float(model.qpos0[model.jnt_qposadr[joint]])
        if model.jnt_type[joint] == _SLIDE:
          pos = pos + quat_apply(quat, moved * axis)
        else:
          held = pos + quat_apply(quat, anchor)
          quat = quat_mul(quat, quat_from_rotvec(moved * axis))
          pos = held - quat_apply(quat, anchor)
      position.append(pos)
      orientation.append(quat)
    return torch.stack(position, 1), torch.stack(orientation, 1)

  def velocities(
    self,
    body_pos: torch.Tensor,
    body_quat: torch.Tensor,
    root_lin_vel: torch.Tensor,
    root_ang_vel: torch.Tensor,
    joint_vel: torch.Tensor,
  ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return linear (frames, bodies, 3) [m/s] and angular velocity [rad/s] of each body at its origin, world axes.

    Args:
      body_pos: As from `poses`.
      body_quat: As from `poses`.
      root_lin_vel: Of the root's origin, world axes, (frames, 3) [m/s].
      root_ang_vel: World axes, (frames, 3) [rad/s].
      joint_vel: (frames, joints) [rad/s or m/s].
    """
    model = self.model
    linear, angular = [root_lin_vel], [root_ang_vel]
    for row, body in enumerate(self._bodies[1:], start=1):
      parent = self.rows[int(model.body_parentid[body])]
      spin = angular[parent]
      moving = linear[parent] + cross(spin, body_pos[:, row] - body_pos[:, parent])
      if (column := self._column.get(body)) is not None:
        joint = self.joint_ids[column]
        axis = quat_apply(body_quat[:, row], joint_vel.new_tensor(model.jnt_axis[joint]))
        rate = joint_vel[:, column, None] * axis
        if model.jnt_type[joint] == _SLIDE:
          moving = moving + rate
        else:
          arm = quat_apply(body_quat[:, row], joint_vel.new_tensor(model.jnt_pos[joint]))
          spin, moving = spin + rate, moving - cross(rate, arm)
      linear.append(moving)
      angular.append(spin)
    return torch.stack(linear, 1), torch.stack(angular, 1)

  def states(self, motion: Motion) -> tuple[torch.Tensor, ...]:
    """Return joint positions and velocities of a motion, in this robot's order, and body states, on its device.

    Body states are positions, orientations, linear and angular velocities, as from `poses` and `velocities`.

    Raises:
      UnknownNameError: See `columns_of`.
    """
    joint_pos, root_pos, root_quat = (
      part.to(self.device) for part in (self.columns_of(motion), motion.root_pos, motion.root_quat)
    )
    joint_vel = derivative(joint_pos, motion.rate)
    pos, quat = self.poses(root_pos, root_quat, joint_pos)
    root_lin_vel, root_ang_vel = derivative(root_pos, motion.rate), angular_velocity(root_quat, motion.rate)
    return joint_pos, joint_vel, pos, quat, *self.velocities(pos, quat, root_lin_vel, root_ang_vel, joint_vel)

  def center_of_mass(self, body_pos: torch.Tensor, body_quat: torch.Tensor) -> torch.Tensor:
    """Return the centre of mass of the whole robot in the world, (frames, 3) [m]."""
    mass = body_pos.new_tensor(self.model.body_mass[self._bodies])
    centers = body_pos + quat_apply(body_quat, body_pos.new_tensor(self.model.body_ipos[self._bodies]))
    return (centers * mass[:, None]).sum(1) / mass.sum()

  def collision_geoms(self) -> list[int]:
    """Return the ids of the robot's geoms that can touch something."""
    model = self.model
    touches = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in self.rows and touches[g]]

  def geom_poses(
    self, geoms: Sequence[int], body_pos: torch.Tensor, body_quat: torch.Tensor
  ) -> tuple[torch.Tensor, torch.Tensor]:
    """Return position (frames, geoms, 3) [m] and orientation (frames, geoms, 4) of the robot's geoms in the world."""
    model, rows = self.model, [self.rows[body] for body in self.model.geom_bodyid[geoms].tolist()]
    turn = body_quat[:, rows]
    pos = body_pos[:, rows] + quat_apply(turn, body_pos.new_tensor(model.geom_pos[geoms]))
    return pos, quat_mul(turn, body_pos.new_tensor(model.geom_quat[geoms]))

  def lowest_points(self, body_pos: torch.Tensor, body_quat: torch.Tensor) -> tuple[torch.Tensor, list[int]]:
    """Return the lowest point of each collision geom, (frames, geoms, 3) [m], and the row of its body.

    Raises:
      MjlabError: A collision geom is neither sphere, capsule, cylinder, ellipsoid nor box.
    """
    geoms = self.collision_geoms()
    if not geoms:
      raise MjlabError("the robot has no collision geoms, so its lowest point is not known")
    pos, quat = self.geom_poses(geoms, body_pos, body_quat)
    edges, axes = pos.new_tensor([self._edges_and_axes(geom) for geom in geoms]).unbind(1)
    # Down, seen in the geom: the support point of the shape in that direction is its lowest.
    turn = matrix_from_quat(quat)
    down = -turn[..., 2, :]
    round_part = down * axes
    length = torch.linalg.vector_norm(round_part, dim=-1, keepdim=True).clamp(min=1e-12)
    offset = torch.where(down < 0.0, -edges, edges) + round_part * axes / length
    return pos + (turn @ offset[..., None]).squeeze(-1), [
      self.rows[body] for body in self.model.geom_bodyid[geoms].tolist()
    ]

  def _edges_and_axes(self, geom: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the half edges of a box and the semi-axes of an ellipsoid whose sum is the geom [m]."""
    a, b, c = self.model.geom_size[geom].tolist()
    match self.model.geom_type[geom]:
      case mujoco.mjtGeom.mjGEOM_SPHERE:
        return (0.0, 0.0, 0.0), (a, a, a)
      case mujoco.mjtGeom.mjGEOM_CAPSULE:
        return (0.0, 0.0, b), (a, a, a)
      case mujoco.mjtGeom.mjGEOM_CYLINDER:
        return (0.0, 0.0, b), (a, a, 0.0)
      case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return (0.0, 0.0, 0.0), (a, b, c)
      case mujoco.mjtGeom.mjGEOM_BOX:
        return (a, b, c), (0.0, 0.0, 0.0)
    raise MjlabError(f"geom '{self.model.geom(geom).name}' is a mesh or a plane; its lowest point is not known")

  def columns_of(self, motion: Motion) -> torch.Tensor:
    """Return the joint positions of a motion in this robot's order, (frames, joints) [rad or m].

    Raises:
      UnknownNameError: The motion is not of this robot; the message gives the nearest name.
    """
    owner = f"motion '{motion.name}' does not fit the robot"
    check_name("root body of the robot", motion.root_body, [self.root_body], owner)
    for name in motion.joint_names:
      check_name("joint of the robot", name, self.joint_names, owner)
    order = [
      motion.joint_names.index(check_name("joint of the motion", n, motion.joint_names, owner))
      for n in self.joint_names
    ]
    return motion.joint_pos[:, order]

  def local_name(self, name: str) -> str:
    """Return a name of the model without the prefix."""
    return name.removeprefix(self.prefix)


def derived_arrays(motion: Motion, robot: Kinematics) -> dict[str, np.ndarray]:
  """Return velocities and body states of a motion, float32, under the keys that BeyondMimic and mjlab read.

  `joint_vel` is in the order of the motion's own joint names; bodies are in the order of `body_names`.
  """
  _, _, pos, quat, linear, angular = robot.states(motion)
  arrays = {
    "joint_vel": derivative(motion.joint_pos, motion.rate),
    "body_pos_w": pos,
    "body_quat_w": quat,
    "body_lin_vel_w": linear,
    "body_ang_vel_w": angular,
  }
  return {
    "body_names": np.array(robot.body_names),
    **{name: value.numpy().astype(np.float32) for name, value in arrays.items()},
  }
