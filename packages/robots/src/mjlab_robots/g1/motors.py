"""The four motors of the G1, their servos, and what one unit of action means."""

from mjlab_actuators import ActuatorCfg, reflected_inertia, reflected_inertia_of_stages

from mjlab_robots.motors import Motor, action_scales, position_servos

# Inertias are of the rotor and of the two planetary stages, ratios of the stages, motor side first.
MOTOR_5020 = Motor(
  armature=reflected_inertia_of_stages((1.39e-5, 1.7e-6, 1.69e-5), (1 + 46 / 18, 1 + 56 / 16)),
  effort_limit=25.0,
  velocity_limit=37.0,
)
"""Shoulders, elbows, wrist roll; in pairs, waist roll and pitch and the ankles."""
MOTOR_7520_14 = Motor(
  armature=reflected_inertia_of_stages((4.89e-5, 9.8e-6, 5.33e-5), (4.5, 1 + 48 / 22)),
  effort_limit=88.0,
  velocity_limit=32.0,
)
"""Hip pitch and yaw, waist yaw."""
MOTOR_7520_22 = Motor(
  armature=reflected_inertia_of_stages((4.89e-5, 1.09e-5, 7.38e-5), (4.5, 5.0)),
  effort_limit=139.0,
  velocity_limit=20.0,
)
"""Hip roll and knee."""
MOTOR_4010 = Motor(armature=reflected_inertia(6.8e-6, 5.0 * 5.0), effort_limit=5.0, velocity_limit=22.0)
"""Wrist pitch and yaw."""

# Rods drive waist and ankles from two motors each. Their ratio is 1 in the middle of the range and taken so throughout,
# and each of the two joints gets the torque of both motors: the coupled limit of the real pair is a rotated square.
_MOTORS = {
  (
    ".*_elbow_joint",
    ".*_shoulder_pitch_joint",
    ".*_shoulder_roll_joint",
    ".*_shoulder_yaw_joint",
    ".*_wrist_roll_joint",
  ): MOTOR_5020,
  (".*_hip_pitch_joint", ".*_hip_yaw_joint", "waist_yaw_joint"): MOTOR_7520_14,
  (".*_hip_roll_joint", ".*_knee_joint"): MOTOR_7520_22,
  (".*_wrist_pitch_joint", ".*_wrist_yaw_joint"): MOTOR_4010,
  ("waist_pitch_joint", "waist_roll_joint"): MOTOR_5020.pair(),
  (".*_ankle_pitch_joint", ".*_ankle_roll_joint"): MOTOR_5020.pair(),
}

G1_ACTUATORS: tuple[ActuatorCfg, ...] = position_servos(_MOTORS)
"""Position servos. In ctrl arms come first, motor by motor; actions follow the joints: legs, waist, arms."""

G1_ACTION_SCALE: dict[str, float] = action_scales(_MOTORS)
"""Set-point shift of one unit of action, by joint pattern [rad]: q_target = q_default + scale * action."""
