"""The YAM's MJCF and where its meshes sit."""

from importlib import resources

import mujoco

from mjlab_robots.meshes import MeshMode
from mjlab_robots.model import MeshGeom, robot_spec

# Files of a link share a frame, and most links' are numbered through.
_UPPER_ARM = ((0.0199992, -0.1041, -2.44738e-05), (1.0, -1.0, -1.0, -1.0))
_FOREARM = ((-0.244001, 0.104101, 2.44738e-05), (1.0, 1.0, 1.0, -1.0))
_HAND = ((0.0, -0.164101, -0.110597), (1.0, -1.0, 0.0, 0.0))
_LEFT_FINGER = ((0.171097, -0.203301, 0.037), (1.0, -1.0, -1.0, -1.0))
_RIGHT_FINGER = ((0.171097, -0.124901, -0.037), (1.0, -1.0, -1.0, -1.0))
_MESHES = tuple(
  MeshGeom(body=body, file=f"{mesh}.stl", material=material, pos=pos, quat=quat)
  for body, mesh, material, (pos, quat) in (
    ("arm", "model2", "black", ((0.0, 0.0, -0.0006), (1.0, 0.0, 0.0, 1.0))),
    ("link_1", "model2__2", "black", ((5.26159e-07, 2.34355e-07, -0.0632), (1.0, 0.0, 0.0, 0.0))),
    ("link_2", "model2__3", "black", _UPPER_ARM),
    ("link_2", "model2__4", "black", _UPPER_ARM),
    ("link_2", "model2__5", "white", _UPPER_ARM),
    ("link_3", "model2__6", "black", _FOREARM),
    ("link_3", "model2__7", "black", _FOREARM),
    ("link_3", "model2__8", "white", _FOREARM),
    ("link_3", "model2__9", "black", _FOREARM),
    ("link_4", "model2__10", "black", ((0.00100023, 0.164101, 2.44738e-05), (1.0, 1.0, 1.0, -1.0))),
    ("link_5", "model2__11", "black", ((0.0, -0.0749971, 0.203601), (1.32679e-06, 1.0, 0.0, 0.0))),
    ("link_6", "model2__12", "black", _HAND),
    ("link_6", "model2__13", "black", _HAND),
    ("link_left_finger", "model2__14", "black", _LEFT_FINGER),
    ("link_left_finger", "model2__15", "black", _LEFT_FINGER),
    ("camera_d405", "d405", "black", ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))),
    ("link_right_finger", "model2__16", "black", _RIGHT_FINGER),
    ("link_right_finger", "model2__17", "black", _RIGHT_FINGER),
  )
)


def yam_spec(meshes: MeshMode = "auto") -> mujoco.MjSpec:
  """A new spec of the YAM without actuators, with collision preset "full", cameras and keyframe "home".

  Args:
    meshes: "auto" wears Menagerie's meshes where they are on this machine and is drawn from primitives where they are
      not; "never" takes primitives; "require" raises without meshes; "download" fetches missing ones. Physics is the
      same in all four.

  Raises:
    MeshesNotFoundError: Meshes are required or to be downloaded, and cannot be had.
  """
  mjcf = resources.files("mjlab_robots.yam").joinpath("yam.xml")
  return robot_spec(mjcf, robot="i2rt_yam", geoms=_MESHES, meshes=meshes)
