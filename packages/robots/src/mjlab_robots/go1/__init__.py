"""Unitree Go1: a 12.7 kg quadruped with 12 actuated joints."""

from mjlab_robots.go1.entity import (
  GO1_DEFAULT_HEIGHT,
  GO1_DEFAULT_JOINT_POS,
  GO1_SOFT_JOINT_POS_LIMIT_FACTOR,
  CollisionPreset,
  go1,
)
from mjlab_robots.go1.model import go1_spec
from mjlab_robots.go1.motors import CALF_MOTOR, GO1_ACTION_SCALE, GO1_ACTUATORS, HIP_MOTOR

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
