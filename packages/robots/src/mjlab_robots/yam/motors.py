"""The motors of the YAM, its servos, and what one unit of action means."""

from mjlab_actuators import ActuatorCfg

from mjlab_robots.motors import Motor, action_scales, position_servos

ARM_FREQUENCY, GRIPPER_FREQUENCY = 2.0, 1.0
"""Of servos that move the arm, and the gripper [Hz]."""


def _dm4340(inertia: float) -> Motor:
  """Shoulder and elbow; `inertia` is what the servo moves, the limb's included [kg m^2]."""
  return Motor(
    armature=0.032, effort_limit=28.0, velocity_limit=10.0, servo_inertia=inertia, servo_frequency=ARM_FREQUENCY
  )


def _dm4310(inertia: float) -> Motor:
  """Wrist; `inertia` as for `_dm4340`."""
  return Motor(
    armature=0.0018, effort_limit=10.0, velocity_limit=30.0, servo_inertia=inertia, servo_frequency=ARM_FREQUENCY
  )


# A crank turns 2.7 rad of a DM4310 into 71 mm of opening, of which the fingers get half each.
CRANK = 0.071 / 2.7
"""Travel of the gripper per turn of its motor [m/rad]."""

# A tenth of what the motor could do: enough to hold, too little to crush.
GRIPPER_MOTOR = Motor(
  armature=0.0018 / CRANK**2,
  effort_limit=0.1 * 10.0 / CRANK,
  velocity_limit=30.0 * CRANK,
  servo_inertia=2.781624,
  servo_frequency=GRIPPER_FREQUENCY,
)
"""The gripper's, seen at the left finger: kg, N and m/s."""

_MOTORS: dict[tuple[str, ...], Motor] = {
  ("joint1",): _dm4340(0.123153),
  ("joint2",): _dm4340(0.277411),
  ("joint3",): _dm4340(0.232763),
  ("joint4",): _dm4310(0.030154),
  ("joint5",): _dm4310(0.009126),
  ("joint6",): _dm4310(0.002868),
  ("left_finger",): GRIPPER_MOTOR,
}

YAM_ACTUATORS: tuple[ActuatorCfg, ...] = position_servos(_MOTORS)
"""Position servos of the six joints and of the left finger, which the right one follows."""

YAM_ACTION_SCALE: dict[str, float] = action_scales(_MOTORS)
"""Set-point shift of one unit of action, by joint pattern [rad, m]: q_target = q_default + scale * action.

Those of joint5 and joint6 exceed what the joints can do; a task should clip its set-points.
"""
