"""Unitree G1: a 33.3 kg humanoid with 29 actuated joints."""

from mjlab_robots.g1.robot import (
  G1_ACTION_SCALE,
  G1_ACTUATORS,
  G1_DEFAULT_HEIGHT,
  G1_DEFAULT_JOINT_POS,
  G1_SOFT_JOINT_POS_LIMIT_FACTOR,
  MOTOR_4010,
  MOTOR_5020,
  MOTOR_7520_14,
  MOTOR_7520_22,
  CollisionPreset,
  g1,
  g1_spec,
)

__all__ = [
  "G1_ACTION_SCALE",
  "G1_ACTUATORS",
  "G1_DEFAULT_HEIGHT",
  "G1_DEFAULT_JOINT_POS",
  "G1_SOFT_JOINT_POS_LIMIT_FACTOR",
  "MOTOR_4010",
  "MOTOR_5020",
  "MOTOR_7520_14",
  "MOTOR_7520_22",
  "CollisionPreset",
  "g1",
  "g1_spec",
]
