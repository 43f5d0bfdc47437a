"""The two motors of the Go1, their servos, and what one unit of action means."""

from mjlab_actuators import ActuatorCfg, reflected_inertia

from mjlab_robots.motors import Motor, action_scales, position_servos

ROTOR_INERTIA = 0.000111842
"""Inertia of the rotor, the same in all motors [kg m^2]."""

HIP_MOTOR = Motor(armature=reflected_inertia(ROTOR_INERTIA, 6.0), effort_limit=23.7, velocity_limit=30.1)
"""Abduction and hip pitch."""
# A belt of ratio 1.5 follows the same gearbox.
CALF_MOTOR = Motor(armature=reflected_inertia(ROTOR_INERTIA, 6.0 * 1.5), effort_limit=35.55, velocity_limit=20.06)
"""Knee."""

_MOTORS = {(".*_hip_joint", ".*_thigh_joint"): HIP_MOTOR, (".*_calf_joint",): CALF_MOTOR}

GO1_ACTUATORS: tuple[ActuatorCfg, ...] = position_servos(_MOTORS)
"""Position servos. In ctrl all hips and thighs come before the calves; actions follow the joints, leg by leg."""

GO1_ACTION_SCALE: dict[str, float] = action_scales(_MOTORS)
"""Set-point shift of one unit of action, by joint pattern [rad]: q_target = q_default + scale * action."""
