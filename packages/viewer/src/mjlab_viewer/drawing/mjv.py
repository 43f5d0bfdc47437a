"""Drawn shapes as geoms of MuJoCo's scenes."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from mjlab_viewer.drawing.draw_list import Shapes

_CONNECTORS = {"arrow": mujoco.mjtGeom.mjGEOM_ARROW, "line": mujoco.mjtGeom.mjGEOM_CAPSULE}
_DECOR = mujoco.mjtCatBit.mjCAT_DECOR.value
_ZEROS = np.zeros(3), np.zeros(3), np.zeros(9)


def count_geoms(drawn: Sequence[Shapes]) -> int:
  """Return the number of geoms of a drawing."""
  return sum(map(len, drawn))


def thinned(drawn: Sequence[Shapes], room: int) -> list[Shapes]:
  """Return at most `room` shapes, taken evenly out of all, so that the drawing keeps its form."""
  count = count_geoms(drawn)
  if count <= room:
    return list(drawn)
  # MuJoCo's own geoms may need all the room.
  room = max(room, 0)
  thin, before = [], 0
  for shapes in drawn:
    numbers = before + np.arange(len(shapes) + 1)
    before += len(shapes)
    # A shape stays where the used share of the room, rounded down, grows by one.
    shares = numbers * room // count
    thin.append(shapes.rows(np.flatnonzero(np.diff(shares))))
  return thin


def add_to_scene(scene: mujoco.MjvScene, model: mujoco.MjModel, drawn: Sequence[Shapes]) -> None:
  """Append shapes to a scene, which has room for them. Meshes that the model lacks are left out."""
  geoms, free = scene.geoms, scene.ngeom
  for shapes in drawn:
    mesh = mesh_id(model, shapes.mesh) if shapes.kind == "mesh" else -1
    if shapes.kind == "mesh" and mesh < 0:
      continue
    _init_geoms(geoms[free : free + len(shapes)], shapes, mesh)
    free += len(shapes)
  scene.ngeom = free


def mesh_id(model: mujoco.MjModel, name: str) -> int:
  """Return the number of a mesh, -1 if the model has none of that name."""
  return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_MESH, name)


def _init_geoms(geoms: Sequence[mujoco.MjvGeom], shapes: Shapes, mesh: int) -> None:
  colors = shapes.color.astype(np.float32)
  connector = _CONNECTORS.get(shapes.kind)
  if connector is not None:
    ends = shapes.position + shapes.direction
    for geom, start, end, radius, color in zip(geoms, shapes.position, ends, shapes.size[:, 0], colors, strict=True):
      mujoco.mjv_initGeom(geom, connector, *_ZEROS, color)
      mujoco.mjv_connector(geom, connector, radius, start, end)
      geom.category = _DECOR
    return
  kind = mujoco.mjtGeom.mjGEOM_MESH if mesh >= 0 else mujoco.mjtGeom.mjGEOM_ELLIPSOID
  sizes = np.broadcast_to(shapes.size, (len(shapes), 3))
  matrix = np.zeros(9)
  for geom, position, turn, size, color in zip(geoms, shapes.position, shapes.direction, sizes, colors, strict=True):
    mujoco.mju_quat2Mat(matrix, turn)
    mujoco.mjv_initGeom(geom, kind, size, position, matrix, color)
    geom.category = _DECOR
    if mesh >= 0:
      # MuJoCo draws the mesh itself at even numbers and its convex hull at odd ones.
      geom.dataid = 2 * mesh
