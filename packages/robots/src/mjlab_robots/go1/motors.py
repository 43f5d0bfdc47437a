"""The two motors of the Go1, the servo gains derived from them, and what one unit of action means."""

from dataclasses import dataclass

from mjlab_actuators import ActuatorCfg, NativePositionActuatorCfg, PdGains, gains_from_frequency, reflected_inertia

ROTOR_INERTIA = 0.000111842
"""Inertia of the rotor, the same in all motors [kg m^2]."""
NATURAL_FREQUENCY = 10.0
"""Of a servo that moves nothing but its own reflected rotor [Hz]."""
DAMPING_RATIO = 2.0
"""Overdamped: the limb's own inertia, which the gains leave out, lowers the ratio."""
ACTION_EFFORT_SHARE = 0.25
"""Share of the effort limit that action 1 asks for from rest."""


@dataclass(frozen=True, kw_only=True)
class Go1Motor:
  """A motor with its reduction, seen at the joint."""

  gear_ratio: float
  """Reduction between rotor and joint."""
  effort_limit: float
  """Largest joint torque [N m]."""
  velocity_limit: float
  """Top joint speed [rad/s]; data sheet only, the servo does not know it."""

  @property
  def armature(self) -> float:
    """Reflected rotor inertia, J N^2 [kg m^2]."""
    return reflected_inertia(ROTOR_INERTIA, self.gear_ratio)

  @property
  def gains(self) -> PdGains:
    """kp = J wn^2 [N m/rad] and kd = 2 zeta J wn [N m s/rad]."""
    return gains_from_frequency(self.armature, NATURAL_FREQUENCY, DAMPING_RATIO)

  @property
  def action_scale(self) -> float:
    """Set-point shift of one unit of action [rad]."""
    return ACTION_EFFORT_SHARE * self.effort_limit / self.gains.stiffness


HIP_MOTOR = Go1Motor(gear_ratio=6.0, effort_limit=23.7, velocity_limit=30.1)
"""Abduction and hip pitch."""
# A belt of ratio 1.5 follows the same gearbox.
CALF_MOTOR = Go1Motor(gear_ratio=6.0 * 1.5, effort_limit=35.55, velocity_limit=20.06)
"""Knee."""

_HIP_JOINTS = (".*_hip_joint", ".*_thigh_joint")
_CALF_JOINTS = (".*_calf_joint",)


def _servo(joints: tuple[str, ...], motor: Go1Motor) -> NativePositionActuatorCfg:
  return NativePositionActuatorCfg(
    target_names_expr=joints,
    stiffness=motor.gains.stiffness,
    damping=motor.gains.damping,
    effort_limit=motor.effort_limit,
    armature=motor.armature,
  )


GO1_ACTUATORS: tuple[ActuatorCfg, ...] = (_servo(_HIP_JOINTS, HIP_MOTOR), _servo(_CALF_JOINTS, CALF_MOTOR))
"""Position servos. In ctrl all hips and thighs come before the calves; actions follow the joints, leg by leg."""

GO1_ACTION_SCALE: dict[str, float] = {
  **dict.fromkeys(_HIP_JOINTS, HIP_MOTOR.action_scale),
  **dict.fromkeys(_CALF_JOINTS, CALF_MOTOR.action_scale),
}
"""Set-point shift of one unit of action, by joint pattern [rad]: q_target = q_default + scale * action."""
