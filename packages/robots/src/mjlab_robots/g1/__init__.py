"""Unitree G1, a 33.3 kg humanoid with 29 actuated joints: motors, pose, contact presets and meshes."""

from typing import Literal

import mujoco
from mjlab_actuators import ActuatorCfg, reflected_inertia, reflected_inertia_of_stages
from mjlab_scene import CollisionCfg, EntityCfg

from mjlab_robots.meshes import MeshMode
from mjlab_robots.model import MeshGeom, Robot
from mjlab_robots.motors import Motor, action_scales, position_servos

__all__ = ["g1", "g1_spec"]

# Motors

# Inertias are of the rotor and of the two planetary stages, ratios of the stages, motor side first.
MOTOR_5020 = Motor(
  armature=reflected_inertia_of_stages((1.39e-5, 1.7e-6, 1.69e-5), (1 + 46 / 18, 1 + 56 / 16)),
  effort_limit=25.0,
  velocity_limit=37.0,
)
"""Shoulders, elbows, wrist roll; in pairs, waist roll and pitch and the ankles."""
MOTOR_7520_14 = Motor(
  armature=reflected_inertia_of_stages((4.89e-5, 9.8e-6, 5.33e-5), (4.5, 1 + 48 / 22)),
  effort_limit=88.0,
  velocity_limit=32.0,
)
"""Hip pitch and yaw, waist yaw."""
MOTOR_7520_22 = Motor(
  armature=reflected_inertia_of_stages((4.89e-5, 1.09e-5, 7.38e-5), (4.5, 5.0)),
  effort_limit=139.0,
  velocity_limit=20.0,
)
"""Hip roll and knee."""
MOTOR_4010 = Motor(armature=reflected_inertia(6.8e-6, 5.0 * 5.0), effort_limit=5.0, velocity_limit=22.0)
"""Wrist pitch and yaw."""

# Rods drive waist and ankles from two motors each. Their ratio is 1 in the middle of the range and taken so throughout,
# and each of the two joints gets the torque of both motors: the coupled limit of the real pair is a rotated square.
_MOTORS = {
  (
    ".*_elbow_joint",
    ".*_shoulder_pitch_joint",
    ".*_shoulder_roll_joint",
    ".*_shoulder_yaw_joint",
    ".*_wrist_roll_joint",
  ): MOTOR_5020,
  (".*_hip_pitch_joint", ".*_hip_yaw_joint", "waist_yaw_joint"): MOTOR_7520_14,
  (".*_hip_roll_joint", ".*_knee_joint"): MOTOR_7520_22,
  (".*_wrist_pitch_joint", ".*_wrist_yaw_joint"): MOTOR_4010,
  ("waist_pitch_joint", "waist_roll_joint"): MOTOR_5020.pair(),
  (".*_ankle_pitch_joint", ".*_ankle_roll_joint"): MOTOR_5020.pair(),
}

G1_ACTUATORS: tuple[ActuatorCfg, ...] = position_servos(_MOTORS)
"""Position servos. In ctrl arms come first, motor by motor; actions follow the joints: legs, waist, arms."""

G1_ACTION_SCALE: dict[str, float] = action_scales(_MOTORS)
"""Shift of the target per unit of action, by joint pattern [rad]: q_target = q_default + scale * action."""

# Pose and contacts

CollisionPreset = Literal["full", "full_without_self", "feet_only"]
"""Everything collides and only feet resist sliding; the same, but never with itself; or only feet collide, and only
with the ground."""

G1_DEFAULT_HEIGHT = 0.76
"""Height of the pelvis in the keyframe "knees_bent" [m]; the soles are 3 mm above 0."""

G1_DEFAULT_JOINT_POS: dict[str, float] = {
  ".*_hip_pitch_joint": -0.312,
  ".*_knee_joint": 0.669,
  ".*_ankle_pitch_joint": -0.363,
  ".*_shoulder_pitch_joint": 0.2,
  "left_shoulder_roll_joint": 0.2,
  "right_shoulder_roll_joint": -0.2,
  ".*_elbow_joint": 0.6,
}
"""Standing pose by joint pattern [rad]; joints that are not named stand at 0."""

_FEET = r".*_foot[1-7]_collision"

_SLIDING_FEET = CollisionCfg(
  geom_names_expr=_FEET, contype=0, conaffinity=1, condim=3, priority=1, friction=(0.6, 0.005, 0.0001)
)
_REST = CollisionCfg(geom_names_expr=rf"(?!{_FEET}).*_collision", contype=0, conaffinity=1, condim=1)
_PRESETS: dict[str, tuple[CollisionCfg, ...]] = {
  "full": (),
  "full_without_self": (_SLIDING_FEET, _REST),
  "feet_only": (_SLIDING_FEET,),
}

# Model

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

_G1 = Robot(
  mjcf="g1/g1.xml",
  menagerie="unitree_g1",
  meshes=_MESHES,
  height=G1_DEFAULT_HEIGHT,
  joint_pos=G1_DEFAULT_JOINT_POS,
  actuators=G1_ACTUATORS,
  presets=_PRESETS,
)


def g1_spec(meshes: MeshMode = "auto") -> mujoco.MjSpec:
  """Return a new spec of the G1 with sensors and keyframes "knees_bent" and "home", without actuators: `Robot.spec`."""
  return _G1.spec(meshes)


def g1(*, meshes: MeshMode = "auto", collision: CollisionPreset = "full") -> EntityCfg:
  """Return a new config of the G1; contact preset "full" is that of the MJCF. See `Robot.entity`."""
  return _G1.entity(g1_spec, meshes, collision)
