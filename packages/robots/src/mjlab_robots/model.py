"""A robot's MJCF, drawn from its own primitives or wearing meshes."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources.abc import Traversable
from pathlib import Path

import mujoco

from mjlab_robots.meshes import MeshMode, find_meshes

VISUAL_GROUP = 2
"""Geom group of what is only drawn, primitives and meshes alike."""


@dataclass(frozen=True, kw_only=True)
class MeshGeom:
  """Where a mesh file sits on a robot."""

  body: str
  file: str
  """Name in the robot's folder of mesh files; the mesh is called like it, without the ending."""
  material: str
  pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
  """In the body's frame [m]."""
  quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


def robot_spec(mjcf: Traversable, *, robot: str, geoms: Sequence[MeshGeom], meshes: MeshMode) -> mujoco.MjSpec:
  """A new spec of `mjcf`, whose geoms of `VISUAL_GROUP` give way to `geoms` where meshes are found.

  Args:
    mjcf: Its default class "visual" is that of everything that is only drawn.
    robot: Name in MuJoCo Menagerie, such as "unitree_go1".
    geoms: What the robot wears.
    meshes: Where meshes come from, see `find_meshes`. Physics is the same with and without.

  Raises:
    MeshesNotFoundError: Meshes are required or to be downloaded, and cannot be had.
  """
  folder = find_meshes(robot, sorted({geom.file for geom in geoms}), meshes)
  spec = mujoco.MjSpec.from_string(mjcf.read_text(encoding="utf-8"))
  if folder is not None:
    _wear(spec, geoms, folder)
  return spec


def _wear(spec: mujoco.MjSpec, geoms: Sequence[MeshGeom], folder: Path) -> None:
  for geom in [geom for geom in spec.geoms if geom.group == VISUAL_GROUP]:
    spec.delete(geom)
  for file in sorted({geom.file for geom in geoms}):
    # Absolute, so that the spec can be attached to any other whatever its mesh folder is.
    spec.add_mesh(name=Path(file).stem, file=str((folder / file).resolve()))
  visual = spec.find_default("visual")
  for geom in geoms:
    spec.body(geom.body).add_geom(
      visual,
      type=mujoco.mjtGeom.mjGEOM_MESH,
      meshname=Path(geom.file).stem,
      material=geom.material,
      pos=geom.pos,
      quat=geom.quat,
    )
