"""Unitree Go2: a 15.2 kg quadruped with 12 actuated joints."""

from mjlab_robots.go2.robot import (
  CALF_MOTOR,
  GO2_ACTION_SCALE,
  GO2_ACTUATORS,
  GO2_DEFAULT_HEIGHT,
  GO2_DEFAULT_JOINT_POS,
  GO2_SOFT_JOINT_POS_LIMIT_FACTOR,
  HIP_MOTOR,
  CollisionPreset,
  go2,
  go2_spec,
)

__all__ = [
  "CALF_MOTOR",
  "GO2_ACTION_SCALE",
  "GO2_ACTUATORS",
  "GO2_DEFAULT_HEIGHT",
  "GO2_DEFAULT_JOINT_POS",
  "GO2_SOFT_JOINT_POS_LIMIT_FACTOR",
  "HIP_MOTOR",
  "CollisionPreset",
  "go2",
  "go2_spec",
]
