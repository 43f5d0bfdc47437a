"""I2RT YAM: a 4 kg arm of six joints with a parallel gripper."""

from mjlab_robots.yam.robot import (
  GRIPPER_MOTOR,
  YAM_ACTION_SCALE,
  YAM_ACTUATORS,
  YAM_DEFAULT_HEIGHT,
  YAM_DEFAULT_JOINT_POS,
  YAM_SOFT_JOINT_POS_LIMIT_FACTOR,
  CollisionPreset,
  yam,
  yam_spec,
)

__all__ = [
  "GRIPPER_MOTOR",
  "YAM_ACTION_SCALE",
  "YAM_ACTUATORS",
  "YAM_DEFAULT_HEIGHT",
  "YAM_DEFAULT_JOINT_POS",
  "YAM_SOFT_JOINT_POS_LIMIT_FACTOR",
  "CollisionPreset",
  "yam",
  "yam_spec",
]
