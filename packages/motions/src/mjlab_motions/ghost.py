"""Ghost of a robot: its shapes, drawn transparently in any pose."""

import mujoco
import numpy as np
import torch
from mjlab_core import DebugDraw
from mjlab_core.rotations import quat_apply, quat_conjugate, quat_mul

from mjlab_motions.kinematics import Kinematics

COLOR = (0.3, 0.6, 1.0, 0.35)
VISUAL_GROUP = 2
"""Group of the drawn geoms. If the robot has none in it, all are drawn."""


class Ghost:
  """Drawing of a robot in any pose.

  Args:
    robot: The robot. Poses are computed on its device.
  """

  def __init__(self, robot: Kinematics) -> None:
    self._robot, model = robot, robot.model
    own = [g for g in range(model.ngeom) if robot.local_name(model.body(model.geom_bodyid[g]).name) in robot.body_names]
    shown = [g for g in own if model.geom_group[g] == VISUAL_GROUP] or own
    self._rows = [robot.body_names.index(robot.local_name(model.body(model.geom_bodyid[g]).name)) for g in shown]
    self._geoms = shown

  def draw(self, draw: DebugDraw, root_pos: torch.Tensor, root_quat: torch.Tensor, joint_pos: torch.Tensor) -> None:
    """Draw one robot for each row.

    Args:
      draw: Canvas.
      root_pos: (n, 3) [m].
      root_quat: (n, 4).
      joint_pos: In the order of the robot's joint names, (n, joints) [rad or m].
    """
    model = self._robot.model
    body_pos, body_quat = self._robot.poses(root_pos, root_quat, joint_pos)
    for geom, row in zip(self._geoms, self._rows, strict=True):
      turn = body_quat[:, row]
      pos = body_pos[:, row] + quat_apply(turn, self._constant(model.geom_pos[geom], turn).expand(turn.shape[0], 3))
      quat = quat_mul(turn, self._constant(model.geom_quat[geom], turn).expand(turn.shape[0], 4))
      self._draw_geom(draw, geom, pos, quat)

  def _draw_geom(self, draw: DebugDraw, geom: int, pos: torch.Tensor, quat: torch.Tensor) -> None:
    model = self._robot.model
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
      mesh = int(model.geom_dataid[geom])
      # MuJoCo stores a mesh about its centre of mass; drawings use the frame of the file.
      back = quat_conjugate(self._constant(model.mesh_quat[mesh], quat)).expand(quat.shape[0], 4)
      own = quat_mul(quat, back)
      origin = pos - quat_apply(own, self._constant(model.mesh_pos[mesh], pos).expand(pos.shape[0], 3))
      draw.meshes(model.mesh(mesh).name, origin, own, COLOR)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
      along = quat_apply(quat, self._constant([0.0, 0.0, float(size[1])], pos).expand(pos.shape[0], 3))
      draw.lines(pos - along, pos + along, COLOR, float(size[0]))
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
      draw.spheres(pos, float(size[0]), COLOR)
    else:
      # Boxes and cylinders are drawn as inscribed ellipsoids; a cylinder's size has its radius once.
      radii = [size[0], size[0], size[1]] if kind == mujoco.mjtGeom.mjGEOM_CYLINDER else size
      draw.ellipsoids(pos, quat, self._constant(radii, pos).expand(pos.shape[0], 3), COLOR)

  def _constant(self, value: object, like: torch.Tensor) -> torch.Tensor:
    return torch.as_tensor(np.asarray(value), dtype=like.dtype, device=like.device)
