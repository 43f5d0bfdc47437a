"""I2RT YAM, a 4 kg arm of six joints with a parallel gripper: motors, pose, contact presets and meshes."""

from typing import Literal

import mujoco
from mjlab_actuators import ActuatorCfg
from mjlab_scene import CollisionCfg, EntityCfg

from mjlab_robots.meshes import MeshMode
from mjlab_robots.model import MeshGeom, Robot
from mjlab_robots.motors import Motor, action_scales, position_servos

__all__ = ["yam", "yam_spec"]

# Motors

ARM_FREQUENCY, GRIPPER_FREQUENCY = 2.0, 1.0
"""Natural frequencies of the servos of the arm and of the gripper [Hz]."""


def _dm4340(inertia: float) -> Motor:
  """Return the motor of shoulder and elbow; `inertia` is that of rotor and limb [kg m^2]."""
  return Motor(
    armature=0.032, effort_limit=28.0, velocity_limit=10.0, servo_inertia=inertia, servo_frequency=ARM_FREQUENCY
  )


def _dm4310(inertia: float) -> Motor:
  """Return the motor of the wrist; `inertia` is that of rotor and limb [kg m^2]."""
  return Motor(
    armature=0.0018, effort_limit=10.0, velocity_limit=30.0, servo_inertia=inertia, servo_frequency=ARM_FREQUENCY
  )


# A crank turns 2.7 rad of a DM4310 into 71 mm of opening; each finger moves half of it.
CRANK = 0.071 / 2.7
"""Travel of the gripper per turn of its motor [m/rad]."""

# A tenth of the motor's effort is enough to hold objects and does not crush them.
GRIPPER_MOTOR = Motor(
  armature=0.0018 / CRANK**2,
  effort_limit=0.1 * 10.0 / CRANK,
  velocity_limit=30.0 * CRANK,
  servo_inertia=2.781624,
  servo_frequency=GRIPPER_FREQUENCY,
)
"""Motor of the gripper, seen at the left finger: kg, N and m/s."""

_MOTORS: dict[tuple[str, ...], Motor] = {
  ("joint1",): _dm4340(0.123153),
  ("joint2",): _dm4340(0.277411),
  ("joint3",): _dm4340(0.232763),
  ("joint4",): _dm4310(0.030154),
  ("joint5",): _dm4310(0.009126),
  ("joint6",): _dm4310(0.002868),
  ("left_finger",): GRIPPER_MOTOR,
}

YAM_ACTUATORS: tuple[ActuatorCfg, ...] = position_servos(_MOTORS)
"""Position servos of the six joints and of the left finger, which the right one follows."""

YAM_ACTION_SCALE: dict[str, float] = action_scales(_MOTORS)
"""Shift of the target per unit of action, by joint pattern [rad, m]: q_target = q_default + scale * action.

The scales of joint5 and joint6 exceed the range of the joints; a task should clip its targets.
"""

# Pose and contacts

CollisionPreset = Literal["full", "gripper_only"]
"""Everything collides, with itself too; or only the hand and the fingers do."""

YAM_DEFAULT_HEIGHT = 0.01
"""Height of the foot of the base [m]."""

YAM_DEFAULT_JOINT_POS: dict[str, float] = {
  "joint2": 1.047,
  "joint3": 1.05,
  "joint4": -0.9,
  "left_finger": 0.01875,
  "right_finger": -0.01875,
}
"""The pose "home", gripper half open, by joint pattern [rad, m]; joints that are not named stand at 0."""

_TIPS = "[lr]f_down([6-9]|10|11)_collision"

_HAND = CollisionCfg(geom_names_expr="(link6_.|[lr]f_rot.|[lr]f_down[1-5])_collision")
_PRESETS: dict[str, tuple[CollisionCfg, ...]] = {
  "full": (),
  "gripper_only": (_HAND, CollisionCfg(geom_names_expr=_TIPS, condim=6, priority=1)),
}

# Model

# All files of a link share a frame.
_UPPER_ARM = ((0.0199992, -0.1041, -2.44738e-05), (1.0, -1.0, -1.0, -1.0))
_FOREARM = ((-0.244001, 0.104101, 2.44738e-05), (1.0, 1.0, 1.0, -1.0))
_HAND_FRAME = ((0.0, -0.164101, -0.110597), (1.0, -1.0, 0.0, 0.0))
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
    ("link_6", "model2__12", "black", _HAND_FRAME),
    ("link_6", "model2__13", "black", _HAND_FRAME),
    ("link_left_finger", "model2__14", "black", _LEFT_FINGER),
    ("link_left_finger", "model2__15", "black", _LEFT_FINGER),
    ("camera_d405", "d405", "black", ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))),
    ("link_right_finger", "model2__16", "black", _RIGHT_FINGER),
    ("link_right_finger", "model2__17", "black", _RIGHT_FINGER),
  )
)

_YAM = Robot(
  mjcf="yam/yam.xml",
  menagerie="i2rt_yam",
  meshes=_MESHES,
  height=YAM_DEFAULT_HEIGHT,
  joint_pos=YAM_DEFAULT_JOINT_POS,
  actuators=YAM_ACTUATORS,
  presets=_PRESETS,
)


def yam_spec(meshes: MeshMode = "auto") -> mujoco.MjSpec:
  """Return a new spec of the YAM with cameras and keyframe "home", without actuators: `Robot.spec`."""
  return _YAM.spec(meshes)


def yam(*, meshes: MeshMode = "auto", collision: CollisionPreset = "full") -> EntityCfg:
  """Return a new config of the YAM; contact preset "full" is that of the MJCF. See `Robot.entity`."""
  return _YAM.entity(yam_spec, meshes, collision)
