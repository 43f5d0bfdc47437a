"""Terms that only tracking needs."""

from mjlab_tracking.mdp.command import MotionCommand, MotionCommandCfg
from mjlab_tracking.mdp.errors import (
  QUANTITIES,
  Quantity,
  body_orientation_error,
  body_position_error,
  motion_error,
  mpkpe,
  root_relative_mpkpe,
)
from mjlab_tracking.mdp.observations import (
  motion,
  motion_anchor_ori_b,
  motion_anchor_pos_b,
  robot_body_ori_b,
  robot_body_pos_b,
)
from mjlab_tracking.mdp.rewards import (
  motion_body_ang_vel,
  motion_body_lin_vel,
  motion_body_ori,
  motion_body_pos,
  motion_contact,
  motion_global_root_ori,
  motion_global_root_pos,
)
from mjlab_tracking.mdp.terminations import (
  bad_anchor_drift,
  bad_anchor_height,
  bad_anchor_ori,
  bad_anchor_pos,
  bad_body_height,
  bad_motion_body_pos,
  motion_end,
)

__all__ = [
  "QUANTITIES",
  "MotionCommand",
  "MotionCommandCfg",
  "Quantity",
  "bad_anchor_drift",
  "bad_anchor_height",
  "bad_anchor_ori",
  "bad_anchor_pos",
  "bad_body_height",
  "bad_motion_body_pos",
  "body_orientation_error",
  "body_position_error",
  "motion",
  "motion_anchor_ori_b",
  "motion_anchor_pos_b",
  "motion_body_ang_vel",
  "motion_body_lin_vel",
  "motion_body_ori",
  "motion_body_pos",
  "motion_contact",
  "motion_end",
  "motion_error",
  "motion_global_root_ori",
  "motion_global_root_pos",
  "mpkpe",
  "robot_body_ori_b",
  "robot_body_pos_b",
  "root_relative_mpkpe",
]
