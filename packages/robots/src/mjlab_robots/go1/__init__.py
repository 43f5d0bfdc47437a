"""Unitree Go1: a 12.7 kg quadruped with 12 actuated joints."""

from mjlab_robots.go1.robot import (
  CALF_MOTOR,
  GO1_ACTION_SCALE,
  GO1_ACTUATORS,
  GO1_DEFAULT_HEIGHT,
  GO1_DEFAULT_JOINT_POS,
  GO1_SOFT_JOINT_POS_LIMIT_FACTOR,
  HIP_MOTOR,
  CollisionPreset,
  go1,
  go1_spec,
)

__all__ = [
  "CALF_MOTOR",
  "GO1_ACTION_SCALE",
  "GO1_ACTUATORS",
  "GO1_DEFAULT_HEIGHT",
  "GO1_DEFAULT_JOINT_POS",
  "GO1_SOFT_JOINT_POS_LIMIT_FACTOR",
  "HIP_MOTOR",
  "CollisionPreset",
  "go1",
  "go1_spec",
]
