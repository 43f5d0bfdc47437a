"""The Go1's MJCF and where its meshes sit."""

from importlib import resources

import mujoco

from mjlab_robots.meshes import MeshMode
from mjlab_robots.model import MeshGeom, robot_spec

_IDENTITY = (1.0, 0.0, 0.0, 0.0)
# One hip mesh serves all four corners.
_MESHES = tuple(
  MeshGeom(body=body, file=f"{mesh}.stl", material="dark", quat=quat)
  for body, mesh, quat in (
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
)


def go1_spec(meshes: MeshMode = "auto") -> mujoco.MjSpec:
  """A new spec of the Go1 without actuators, with collision preset "full", sensors, cameras and keyframe "stand".

  Args:
    meshes: "auto" wears Menagerie's meshes where they are on this machine and is drawn from primitives where they are
      not; "never" takes primitives; "require" raises without meshes; "download" fetches missing ones. Physics is the
      same in all four.

  Raises:
    MeshesNotFoundError: Meshes are required or to be downloaded, and cannot be had.
  """
  mjcf = resources.files("mjlab_robots.go1").joinpath("go1.xml")
  return robot_spec(mjcf, robot="unitree_go1", geoms=_MESHES, meshes=meshes)
