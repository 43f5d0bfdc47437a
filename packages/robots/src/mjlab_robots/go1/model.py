"""The Go1's MJCF, drawn with meshes or with primitives."""

from importlib import resources
from pathlib import Path

import mujoco

from mjlab_robots.meshes import MeshMode, find_meshes

_VISUAL_GROUP = 2
_IDENTITY = (1.0, 0.0, 0.0, 0.0)
# Body, mesh, orientation of the mesh in the body. One hip mesh serves all four corners.
_MESHES: tuple[tuple[str, str, tuple[float, float, float, float]], ...] = (
  ("trunk", "trunk", _IDENTITY),
  ("FR_hip", "hip", _IDENTITY),
  ("FR_thigh", "thigh_mirror", _IDENTITY),
  ("FR_calf", "calf", _IDENTITY),
  ("FL_hip", "hip", _IDENTITY),
  ("FL_thigh", "thigh", _IDENTITY),
  ("FL_calf", "calf", _IDENTITY),
  ("RR_hip", "hip", (0.0, 0.0, 0.0, -1.0)),
  ("RR_thigh", "thigh_mirror", _IDENTITY),
  ("RR_calf", "calf", _IDENTITY),
  ("RL_hip", "hip", (0.0, 0.0, 1.0, 0.0)),
  ("RL_thigh", "thigh", _IDENTITY),
  ("RL_calf", "calf", _IDENTITY),
)


def go1_spec(meshes: MeshMode = "auto") -> mujoco.MjSpec:
  """A new spec of the Go1 without actuators, with collision preset "full", sensors, cameras and keyframe "stand".

  Args:
    meshes: "auto" wears Menagerie's meshes where they are on this machine and is drawn from primitives where they are
      not; "never" takes primitives; "require" raises without meshes. Physics is the same in all three.

  Raises:
    MeshesNotFoundError: Meshes are required and not found.
  """
  folder = find_meshes("unitree_go1", sorted({f"{mesh}.stl" for _, mesh, _ in _MESHES}), meshes)
  spec = mujoco.MjSpec.from_string(resources.files("mjlab_robots.go1").joinpath("go1.xml").read_text(encoding="utf-8"))
  if folder is not None:
    _wear(spec, folder)
  return spec


def _wear(spec: mujoco.MjSpec, folder: Path) -> None:
  for geom in [geom for geom in spec.geoms if geom.group == _VISUAL_GROUP]:
    spec.delete(geom)
  for mesh in sorted({mesh for _, mesh, _ in _MESHES}):
    # Absolute, so that the spec can be attached to any other whatever its mesh folder is.
    spec.add_mesh(name=mesh, file=str((folder / f"{mesh}.stl").resolve()))
  visual = spec.find_default("visual")
  for body, mesh, quat in _MESHES:
    spec.body(body).add_geom(visual, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh, quat=quat)
