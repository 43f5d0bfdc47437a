"""Forward kinematics of a robot for many frames at once, on any device."""

from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_core.errors import MjlabError
from mjlab_core.names import check_name
from mjlab_core.rotations import cross, matrix_from_quat, quat_apply, quat_from_rotvec, quat_mul

from mjlab_motions.motion import Motion
from mjlab_motions.timeline import angular_velocity, derivative

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_GEOMS = {
  "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
  "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
  "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
  "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
  "box": mujoco.mjtGeom.mjGEOM_BOX,
}


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
    joints = [j for b in self._bodies for j in _joints(model, b)]
    if strange := [model.joint(j).name for j in joints if model.jnt_type[j] not in (_HINGE, _SLIDE)]:
      raise MjlabError(f"joint '{strange[0]}' is neither hinge nor slide; motions have no other joints")
    if crowded := [model.body(b).name for b in self._bodies if len(_joints(model, b)) > 1]:
      raise MjlabError(f"body '{crowded[0]}' has several joints; give each a body of its own")
    self.joint_ids = joints
    """Ids of the joints in the model."""
    self.joint_names = tuple(self.local_name(model.joint(j).name) for j in joints)
    """Names of the joints in the model's order, without the free one."""
    self.body_names = tuple(self.local_name(model.body(b).name) for b in self._bodies)
    """Names of the bodies in the model's order; the first is the root."""
    self._column = {joint: column for column, joint in enumerate(joints)}
    self._row = {body: row for row, body in enumerate(self._bodies)}

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
      parent = self._row[int(model.body_parentid[body])]
      pos = position[parent] + quat_apply(orientation[parent], self._constant(model.body_pos[body], q))
      quat = quat_mul(orientation[parent], self._constant(model.body_quat[body], q).expand(q.shape[0], 4))
      for joint in _joints(model, body):
        axis, anchor = self._constant(model.jnt_axis[joint], q), self._constant(model.jnt_pos[joint], q)
        moved = q[:, self._column[joint], None] - float(model.qpos0[model.jnt_qposadr[joint]])
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
      parent = self._row[int(model.body_parentid[body])]
      spin = angular[parent]
      moving = linear[parent] + cross(spin, body_pos[:, row] - body_pos[:, parent])
      for joint in _joints(model, body):
        axis = quat_apply(body_quat[:, row], self._constant(model.jnt_axis[joint], joint_vel))
        rate = joint_vel[:, self._column[joint], None] * axis
        if model.jnt_type[joint] == _SLIDE:
          moving = moving + rate
        else:
          arm = quat_apply(body_quat[:, row], self._constant(model.jnt_pos[joint], joint_vel))
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
    mass = self._constant(self.model.body_mass[self._bodies], body_pos)
    centers = body_pos + quat_apply(body_quat, self._constant(self.model.body_ipos[self._bodies], body_pos))
    return (centers * mass[:, None]).sum(1) / mass.sum()

  def collision_geoms(self) -> list[int]:
    """Return the ids of the robot's geoms that can touch something."""
    model = self.model
    touches = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in self._row and touches[g]]

  def lowest_points(self, body_pos: torch.Tensor, body_quat: torch.Tensor) -> tuple[torch.Tensor, list[int]]:
    """Return the lowest point of each collision geom, (frames, geoms, 3) [m], and the row of its body.

    Raises:
      MjlabError: A collision geom is neither sphere, capsule, cylinder, ellipsoid nor box.
    """
    model = self.model
    points, rows = [], []
    for geom in self.collision_geoms():
      row = self._row[int(model.geom_bodyid[geom])]
      center = body_pos[:, row] + quat_apply(body_quat[:, row], self._constant(model.geom_pos[geom], body_pos))
      turned = self._constant(model.geom_quat[geom], body_pos).expand(body_pos.shape[0], 4)
      # Down, seen in the geom: the support point of the shape in that direction is its lowest.
      turn = matrix_from_quat(quat_mul(body_quat[:, row], turned))
      offset = self._support(geom, -turn[:, 2, :])
      points.append(center + (turn @ offset[..., None]).squeeze(-1))
      rows.append(row)
    if not points:
      raise MjlabError("the robot has no collision geoms, so its lowest point is not known")
    return torch.stack(points, 1), rows

  def _support(self, geom: int, direction: torch.Tensor) -> torch.Tensor:
    kind, (a, b, c) = int(self.model.geom_type[geom]), self.model.geom_size[geom]
    sign = torch.where(direction < 0.0, -1.0, 1.0).to(direction.dtype)
    if kind == _GEOMS["sphere"]:
      return a * direction
    if kind == _GEOMS["capsule"]:
      return torch.cat((a * direction[:, :2], a * direction[:, 2:] + b * sign[:, 2:]), -1)
    if kind == _GEOMS["box"]:
      return sign * torch.tensor([a, b, c], dtype=direction.dtype, device=direction.device)
    if kind == _GEOMS["ellipsoid"]:
      scaled = direction * torch.tensor([a, b, c], dtype=direction.dtype, device=direction.device)
      length = torch.linalg.vector_norm(scaled, dim=-1, keepdim=True)
      return scaled * torch.tensor([a, b, c], dtype=direction.dtype, device=direction.device) / length
    if kind == _GEOMS["cylinder"]:
      side = torch.linalg.vector_norm(direction[:, :2], dim=-1, keepdim=True).clamp(min=1e-12)
      return torch.cat((a * direction[:, :2] / side, b * sign[:, 2:]), -1)
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

  def _constant(self, value: Any, like: torch.Tensor) -> torch.Tensor:
    return torch.as_tensor(np.asarray(value), dtype=like.dtype, device=like.device)


def _joints(model: mujoco.MjModel, body: int) -> list[int]:
  first = int(model.body_jntadr[body])
  joints = range(first, first + int(model.body_jntnum[body]))
  return [j for j in joints if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE]


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
