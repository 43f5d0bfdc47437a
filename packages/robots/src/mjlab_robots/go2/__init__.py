"""Unitree Go2, a 15.2 kg quadruped with 12 actuated joints: motors, pose, contact presets and meshes."""

from dataclasses import replace
from typing import Literal

import mujoco
from mjlab_actuators import ActuatorCfg, reflected_inertia
from mjlab_scene import CollisionCfg, EntityCfg

from mjlab_robots.go1 import FEET, ROTOR_INERTIA
from mjlab_robots.meshes import MeshMode
from mjlab_robots.model import MeshGeom, Robot
from mjlab_robots.motors import Motor, action_scales, position_servos

__all__ = ["go2", "go2_spec"]

# Motors

HIP_GEAR_RATIO = 6.33
"""Gear ratio of the motor GO-M8010-6."""
KNEE_LINKAGE_RATIO = 45.43 / 23.7
"""Ratio of the linkage that follows the same gearbox: that of the effort limits."""

# The rotors are assumed to be those of the Go1.
HIP_MOTOR = Motor(armature=reflected_inertia(ROTOR_INERTIA, HIP_GEAR_RATIO), effort_limit=23.7, velocity_limit=30.1)
"""Abduction and hip pitch."""
CALF_MOTOR = Motor(
  armature=reflected_inertia(ROTOR_INERTIA, HIP_GEAR_RATIO * KNEE_LINKAGE_RATIO),
  effort_limit=45.43,
  velocity_limit=15.7,
)
"""Knee."""

_MOTORS = {(".*_hip_joint", ".*_thigh_joint"): HIP_MOTOR, (".*_calf_joint",): CALF_MOTOR}

GO2_ACTUATORS: tuple[ActuatorCfg, ...] = position_servos(_MOTORS)
"""Position servos. In ctrl all hips and thighs come before the calves; actions follow the joints, leg by leg."""

GO2_ACTION_SCALE: dict[str, float] = action_scales(_MOTORS)
"""Shift of the target per unit of action, by joint pattern [rad]: q_target = q_default + scale * action."""

# Pose and contacts

CollisionPreset = Literal["full", "feet_only"]
"""Everything collides and only feet resist sliding; or only feet collide, and only with the ground."""

GO2_DEFAULT_HEIGHT = 0.27
"""Height of the base in the keyframe "stand" [m]; the feet reach 18 mm below 0, so a reset must lift the robot."""

GO2_DEFAULT_JOINT_POS: dict[str, float] = {
  ".*_hip_joint": 0.0,
  ".*_thigh_joint": 0.9,
  ".*_calf_joint": -1.8,
}
"""Standing pose by joint pattern [rad]."""

_FEET = replace(FEET, solimp=None)
_PRESETS: dict[str, tuple[CollisionCfg, ...]] = {"full": (), "feet_only": (_FEET,)}

# Model

# Materials of the five parts of the base's mesh and the two of each other.
_BASE = ("dark", "dark", "dark", "shell", "metal")
_HALF_TURNS = {"FR": (0.0, 1.0, 0.0, 0.0), "FL": (1.0, 0.0, 0.0, 0.0), "RR": (0.0, 0.0, 0.0, -1.0)}


def _leg_meshes(leg: str) -> list[MeshGeom]:
  mirrored = "_mirror" if leg[1] == "R" else ""
  # One hip mesh serves all four corners.
  turn = _HALF_TURNS.get(leg, (0.0, 0.0, 1.0, 0.0))
  parts = [(f"{leg}_hip", "hip", ("metal", "shell")), (f"{leg}_thigh", f"thigh{mirrored}", ("metal", "shell"))]
  parts.append((f"{leg}_calf", f"calf{mirrored}", ("shell", "dark")))
  meshes = [
    MeshGeom(
      body=body,
      file=f"{mesh}_{i}.obj",
      material=material,
      quat=turn if mesh == "hip" else (1.0, 0.0, 0.0, 0.0),
    )
    for body, mesh, materials in parts
    for i, material in enumerate(materials)
  ]
  return [*meshes, MeshGeom(body=f"{leg}_calf", file="foot.obj", material="rubber", pos=(0.0, 0.0, -0.213))]


_MESHES = (
  *(MeshGeom(body="base", file=f"base_{i}.obj", material=material) for i, material in enumerate(_BASE)),
  *(mesh for leg in ("FR", "FL", "RR", "RL") for mesh in _leg_meshes(leg)),
)

_GO2 = Robot(
  mjcf="go2/go2.xml",
  menagerie="unitree_go2",
  meshes=_MESHES,
  height=GO2_DEFAULT_HEIGHT,
  joint_pos=GO2_DEFAULT_JOINT_POS,
  actuators=GO2_ACTUATORS,
  presets=_PRESETS,
)


def go2_spec(meshes: MeshMode = "auto") -> mujoco.MjSpec:
  """Return a new spec of the Go2 with sensors, camera and keyframe "stand", without actuators: `Robot.spec`."""
  return _GO2.spec(meshes)


def go2(*, meshes: MeshMode = "auto", collision: CollisionPreset = "full") -> EntityCfg:
  """Return a new config of the Go2; contact preset "full" is that of the MJCF. See `Robot.entity`."""
  return _GO2.entity(go2_spec, meshes, collision)
