"""Drawn shapes as geoms of MuJoCo's scenes."""

from __future__ import annotations

import mujoco
import numpy as np

from mjlab_viewer.draw_list import DrawList, Shapes

_CONNECTORS = {"arrow": mujoco.mjtGeom.mjGEOM_ARROW, "line": mujoco.mjtGeom.mjGEOM_CAPSULE}


def count_geoms(drawing: DrawList) -> int:
  """How many geoms a drawing takes."""
  return sum(map(len, drawing.shapes))


def add_to_scene(scene: mujoco.MjvScene, model: mujoco.MjModel, drawing: DrawList) -> int:
  """Append what was drawn to a scene; returns how many shapes did not fit."""
  for shapes in drawing.shapes:
    mesh = mesh_id(model, shapes.mesh) if shapes.kind == "mesh" else -1
    if shapes.kind == "mesh" and mesh < 0:
      continue
    room = scene.maxgeom - scene.ngeom
    for row in range(min(len(shapes), room)):
      _init_geom(scene.geoms[scene.ngeom], shapes, row, mesh)
      scene.ngeom += 1
  return max(0, count_geoms(drawing) - scene.maxgeom)


def mesh_id(model: mujoco.MjModel, name: str) -> int:
  """Number of a mesh, -1 if the model has none of that name."""
  return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_MESH, name)


def _init_geom(geom: mujoco.MjvGeom, shapes: Shapes, row: int, mesh: int) -> None:
  position, direction = shapes.position[row], shapes.direction[row]
  color = shapes.color[row].astype(np.float32)
  if shapes.kind in _CONNECTORS:
    kind = _CONNECTORS[shapes.kind]
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), color)
    mujoco.mjv_connector(geom, kind, float(shapes.size[row, 0]), position, position + direction)
  else:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, direction)
    kind = mujoco.mjtGeom.mjGEOM_MESH if mesh >= 0 else mujoco.mjtGeom.mjGEOM_ELLIPSOID
    size = np.ones(3) if mesh >= 0 else shapes.size[row]
    mujoco.mjv_initGeom(geom, kind, size, position, matrix, color)
    if mesh >= 0:
      # MuJoCo draws the mesh itself at even numbers and its convex hull at odd ones.
      geom.dataid = 2 * mesh
  geom.category = mujoco.mjtCatBit.mjCAT_DECOR
