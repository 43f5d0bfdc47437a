"""The term library: what observations, rewards, events and the like any task can use."""

from mjlab_envs.mdp.actions import (
  JointActionCfg,
  JointEffortAction,
  JointEffortActionCfg,
  JointPositionAction,
  JointPositionActionCfg,
  JointVelocityAction,
  JointVelocityActionCfg,
)
from mjlab_envs.mdp.events import (
  push_by_setting_velocity,
  reset_joints_by_offset,
  reset_root_state_uniform,
  reset_scene_to_default,
)
from mjlab_envs.mdp.metrics import mean_action_acc
from mjlab_envs.mdp.observations import (
  base_ang_vel,
  base_lin_vel,
  builtin_sensor,
  generated_commands,
  height_scan,
  joint_pos_rel,
  joint_vel_rel,
  last_action,
  projected_gravity,
)
from mjlab_envs.mdp.randomize import randomize
from mjlab_envs.mdp.rewards import (
  action_acc_l2,
  action_rate_l2,
  flat_orientation_l2,
  is_alive,
  is_terminated,
  joint_acc_l2,
  joint_pos_limits,
  joint_torques_l2,
  joint_vel_l2,
  posture,
)
from mjlab_envs.mdp.terminations import bad_orientation, nan_detection, root_height_below_minimum, time_out

__all__ = [
  "JointActionCfg",
  "JointEffortAction",
  "JointEffortActionCfg",
  "JointPositionAction",
  "JointPositionActionCfg",
  "JointVelocityAction",
  "JointVelocityActionCfg",
  "action_acc_l2",
  "action_rate_l2",
  "bad_orientation",
  "base_ang_vel",
  "base_lin_vel",
  "builtin_sensor",
  "flat_orientation_l2",
  "generated_commands",
  "height_scan",
  "is_alive",
  "is_terminated",
  "joint_acc_l2",
  "joint_pos_limits",
  "joint_pos_rel",
  "joint_torques_l2",
  "joint_vel_l2",
  "joint_vel_rel",
  "last_action",
  "mean_action_acc",
  "nan_detection",
  "posture",
  "projected_gravity",
  "push_by_setting_velocity",
  "randomize",
  "reset_joints_by_offset",
  "reset_root_state_uniform",
  "reset_scene_to_default",
  "root_height_below_minimum",
  "time_out",
]
