"""The G1's MJCF and where its meshes sit."""

from importlib import resources

import mujoco

from mjlab_robots.meshes import MeshMode
from mjlab_robots.model import MeshGeom, robot_spec

_ARM_AND_LEG = (
  ("hip_pitch_link", "black"),
  ("hip_roll_link", "silver"),
  ("hip_yaw_link", "silver"),
  ("knee_link", "silver"),
  ("ankle_pitch_link", "silver"),
  ("ankle_roll_link", "black"),
  ("shoulder_pitch_link", "silver"),
  ("shoulder_roll_link", "silver"),
  ("shoulder_yaw_link", "silver"),
  ("elbow_link", "silver"),
  ("wrist_roll_link", "silver"),
  ("wrist_pitch_link", "silver"),
  ("wrist_yaw_link", "silver"),
)
# The head is drawn in the frame of the waist, below the axes of the waist's roll and pitch.
_WAIST_IN_TORSO = (0.0039635, 0.0, -0.044)
_MESHES = (
  MeshGeom(body="pelvis", file="pelvis.STL", material="black"),
  MeshGeom(body="pelvis", file="pelvis_contour_link.STL", material="silver"),
  MeshGeom(body="waist_yaw_link", file="waist_yaw_link_rev_1_0.STL", material="silver"),
  MeshGeom(body="waist_roll_link", file="waist_roll_link_rev_1_0.STL", material="silver"),
  MeshGeom(body="torso_link", file="torso_link_rev_1_0.STL", material="silver"),
  MeshGeom(body="torso_link", file="logo_link.STL", material="black", pos=_WAIST_IN_TORSO),
  MeshGeom(body="torso_link", file="head_link.STL", material="black", pos=_WAIST_IN_TORSO),
  *(
    MeshGeom(body=f"{side}_{link}", file=f"{side}_{link}.STL", material=material)
    for side in ("left", "right")
    for link, material in _ARM_AND_LEG
  ),
  *(
    MeshGeom(body=f"{side}_wrist_yaw_link", file=f"{side}_rubber_hand.STL", material="black", pos=(0.0415, y, 0.0))
    for side, y in (("left", 0.003), ("right", -0.003))
  ),
)


def g1_spec(meshes: MeshMode = "auto") -> mujoco.MjSpec:
  """A new spec of the G1 without actuators, with collision preset "full", sensors and keyframes "knees_bent", "home".

  Args:
    meshes: "auto" wears Menagerie's meshes where they are on this machine and is drawn from primitives where they are
      not; "never" takes primitives; "require" raises without meshes; "download" fetches missing ones. Physics is the
      same in all four.

  Raises:
    MeshesNotFoundError: Meshes are required or to be downloaded, and cannot be had.
  """
  mjcf = resources.files("mjlab_robots.g1").joinpath("g1.xml")
  return robot_spec(mjcf, robot="unitree_g1", geoms=_MESHES, meshes=meshes)
