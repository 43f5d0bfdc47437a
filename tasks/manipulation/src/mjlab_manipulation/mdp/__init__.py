"""Terms that only manipulation tasks need."""

from mjlab_manipulation.mdp.command import LiftCommand, LiftCommandCfg, Region
from mjlab_manipulation.mdp.images import DATA_OF_CHANNEL, Channel, camera_image
from mjlab_manipulation.mdp.observations import (
  goal_in_hand,
  hand_to_object,
  object_in_hand,
  object_size,
  object_to_goal,
)
from mjlab_manipulation.mdp.rewards import hand_distance, joint_vel_hinge, lift, lift_command, lift_precise
from mjlab_manipulation.mdp.stages import (
  at_goal,
  dropped,
  finger_force,
  goal_over,
  grasped,
  held,
  lifted,
  object_height,
  position_error,
  reached,
  time_to_success,
  touched,
)

__all__ = [
  "DATA_OF_CHANNEL",
  "Channel",
  "LiftCommand",
  "LiftCommandCfg",
  "Region",
  "at_goal",
  "camera_image",
  "dropped",
  "finger_force",
  "goal_in_hand",
  "goal_over",
  "grasped",
  "hand_distance",
  "hand_to_object",
  "held",
  "joint_vel_hinge",
  "lift",
  "lift_command",
  "lift_precise",
  "lifted",
  "object_height",
  "object_in_hand",
  "object_size",
  "object_to_goal",
  "position_error",
  "reached",
  "time_to_success",
  "touched",
]
