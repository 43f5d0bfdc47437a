"""Motors seen at the joint: servo gains and action scales that follow from them."""

from collections.abc import Mapping
from dataclasses import dataclass

from mjlab_actuators import ActuatorCfg, NativePositionActuatorCfg, PdGains, gains_from_frequency

NATURAL_FREQUENCY = 10.0
"""Natural frequency of a servo that moves only its own reflected rotor [Hz]."""
DAMPING_RATIO = 2.0
"""Damping ratio of a servo; the inertia of the limb, which the gains leave out, lowers it."""
ACTION_EFFORT_SHARE = 0.25
"""Share of the effort limit that action 1 requests from rest."""


@dataclass(frozen=True, kw_only=True)
class Motor:
  """A motor with its reduction, seen at the joint."""

  armature: float
  """Inertia of rotor and gears, reflected to the joint [kg m^2]."""
  effort_limit: float
  """Largest joint torque [N m]."""
  velocity_limit: float
  """Top joint speed [rad/s], for policy bundles; the servo does not limit it."""
  servo_inertia: float | None = None
  """Inertia J that the servo is made for [kg m^2]; None for the armature alone."""
  servo_frequency: float = NATURAL_FREQUENCY
  """Natural frequency wn / (2 pi) of the servo with that inertia [Hz]."""

  @property
  def gains(self) -> PdGains:
    """Gains kp = J wn^2 [N m/rad] and kd = 2 zeta J wn [N m s/rad]."""
    inertia = self.armature if self.servo_inertia is None else self.servo_inertia
    return gains_from_frequency(inertia, self.servo_frequency, DAMPING_RATIO)

  @property
  def action_scale(self) -> float:
    """Shift of the target per unit of action [rad]."""
    return ACTION_EFFORT_SHARE * self.effort_limit / self.gains.stiffness

  def pair(self) -> "Motor":
    """Return two of them on one joint through a linkage of ratio 1: twice inertia and torque at the same speed."""
    return Motor(armature=2 * self.armature, effort_limit=2 * self.effort_limit, velocity_limit=self.velocity_limit)


def position_servos(motors: Mapping[tuple[str, ...], Motor]) -> tuple[ActuatorCfg, ...]:
  """Return a group of position servos for each entry of `motors`, joint patterns to motor, in the order of `ctrl`."""
  return tuple(
    NativePositionActuatorCfg(
      target_names_expr=joints,
      stiffness=motor.gains.stiffness,
      damping=motor.gains.damping,
      effort_limit=motor.effort_limit,
      velocity_limit=motor.velocity_limit,
      armature=motor.armature,
    )
    for joints, motor in motors.items()
  )


def action_scales(motors: Mapping[tuple[str, ...], Motor]) -> dict[str, float]:
  """Return the shift of the target per unit of action by joint pattern [rad]: q_target = q_default + scale * action."""
  return {pattern: motor.action_scale for joints, motor in motors.items() for pattern in joints}
