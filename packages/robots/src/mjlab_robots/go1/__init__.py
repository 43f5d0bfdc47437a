"""Unitree Go1, a 12.7 kg quadruped with 12 actuated joints: motors, pose, contact presets and meshes."""

from typing import Literal

import mujoco
from mjlab_actuators import ActuatorCfg, reflected_inertia
from mjlab_scene import CollisionCfg, EntityCfg

from mjlab_robots.meshes import MeshMode
from mjlab_robots.model import MeshGeom, Robot
from mjlab_robots.motors import Motor, action_scales, position_servos

__all__ = ["go1", "go1_spec"]

# Motors

ROTOR_INERTIA = 0.000111842
"""Inertia of the rotor, the same in all motors [kg m^2]."""

HIP_MOTOR = Motor(armature=reflected_inertia(ROTOR_INERTIA, 6.0), effort_limit=23.7, velocity_limit=30.1)
"""Abduction and hip pitch."""
# A belt of ratio 1.5 follows the same gearbox.
CALF_MOTOR = Motor(armature=reflected_inertia(ROTOR_INERTIA, 6.0 * 1.5), effort_limit=35.55, velocity_limit=20.06)
"""Knee."""

_MOTORS = {(".*_hip_joint", ".*_thigh_joint"): HIP_MOTOR, (".*_calf_joint",): CALF_MOTOR}

GO1_ACTUATORS: tuple[ActuatorCfg, ...] = position_servos(_MOTORS)
"""Position servos. In ctrl all hips and thighs come before the calves; actions follow the joints, leg by leg."""

GO1_ACTION_SCALE: dict[str, float] = action_scales(_MOTORS)
"""Shift of the target per unit of action, by joint pattern [rad]: q_target = q_default + scale * action."""

# Pose and contacts

CollisionPreset = Literal["full", "feet_only"]
"""Everything collides and only feet resist sliding; or only feet collide, and only with the ground."""

GO1_DEFAULT_HEIGHT = 0.278
"""Height of the trunk in the keyframe "stand" [m]; the feet reach 16.5 mm below 0, so a reset must lift the robot."""

GO1_DEFAULT_JOINT_POS: dict[str, float] = {
  ".*R_hip_joint": 0.1,
  ".*L_hip_joint": -0.1,
  ".*_thigh_joint": 0.9,
  ".*_calf_joint": -1.8,
}
"""Standing pose by joint pattern [rad]."""

FEET = CollisionCfg(
  geom_names_expr=(".*_foot_collision",),
  contype=0,
  conaffinity=1,
  condim=3,
  priority=1,
  friction=(0.6, 0.005, 0.0001),
  solref=(0.02, 1.0),
  # A foot sinks over its own radius before it is as stiff as it gets.
  solimp=(0.9, 0.95, 0.023, 0.5, 2.0),
  disable_other_geoms=True,
)
"""Feet that collide with the ground only, and resist sliding."""
_PRESETS: dict[str, tuple[CollisionCfg, ...]] = {"full": (), "feet_only": (FEET,)}

# Model

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

_GO1 = Robot(
  mjcf="go1/go1.xml",
  menagerie="unitree_go1",
  meshes=_MESHES,
  height=GO1_DEFAULT_HEIGHT,
  joint_pos=GO1_DEFAULT_JOINT_POS,
  actuators=GO1_ACTUATORS,
  presets=_PRESETS,
)


def go1_spec(meshes: MeshMode = "auto") -> mujoco.MjSpec:
  """Return a new spec of the Go1 with sensors, cameras and keyframe "stand", without actuators: `Robot.spec`."""
  return _GO1.spec(meshes)


def go1(*, meshes: MeshMode = "auto", collision: CollisionPreset = "full") -> EntityCfg:
  """Return a new config of the Go1; contact preset "full" is that of the MJCF. See `Robot.entity`."""
  return _GO1.entity(go1_spec, meshes, collision)
