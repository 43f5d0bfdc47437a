"""Ghost of a robot: its shapes, drawn transparently in any pose."""

import mujoco
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
    own = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in robot.rows]
    self._geoms = [g for g in own if model.geom_group[g] == VISUAL_GROUP] or own

  def draw(self, draw: DebugDraw, root_pos: torch.Tensor, root_quat: torch.Tensor, joint_pos: torch.Tensor) -> None:
    """Draw one robot for each row.

    Args:
      draw: Canvas.
      root_pos: (n, 3) [m].
      root_quat: (n, 4).
      joint_pos: In the order of the robot's joint names, (n, joints) [rad or m].
    """
    pos, quat = self._robot.geom_poses(self._geoms, *self._robot.poses(root_pos, root_quat, joint_pos))
    for i, geom in enumerate(self._geoms):
      self._draw_geom(draw, geom, pos[:, i], quat[:, i])

  def _draw_geom(self, draw: DebugDraw, geom: int, pos: torch.Tensor, quat: torch.Tensor) -> None:
    model = self._robot.model
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
      mesh = int(model.geom_dataid[geom])
      # MuJoCo stores a mesh about its centre of mass; drawings use the frame of the file.
      own = quat_mul(quat, quat_conjugate(quat.new_tensor(model.mesh_quat[mesh])))
      origin = pos - quat_apply(own, pos.new_tensor(model.mesh_pos[mesh]))
      draw.meshes(model.mesh(mesh).name, origin, own, COLOR)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
      along = quat_apply(quat, pos.new_tensor([0.0, 0.0, size[1]]))
      draw.lines(pos - along, pos + along, COLOR, float(size[0]))
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
      draw.spheres(pos, float(size[0]), COLOR)
    else:
      # Boxes and cylinders are drawn as inscribed ellipsoids; a cylinder's size has its radius once.
      radii = [size[0], size[0], size[1]] if kind == mujoco.mjtGeom.mjGEOM_CYLINDER else size
      draw.ellipsoids(pos, quat, pos.new_tensor(radii).expand_as(pos), COLOR)
