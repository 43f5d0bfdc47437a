"""Servos of a robot: read from the actuators of its file, from effort limits, or from motor data of the user."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mjlab_actuators import (
  ActuatorCfg,
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
  XmlActuatorCfg,
  gains_from_frequency,
)
from mjlab_core import MjlabError, printable

from mjlab.new.model_file import RobotModel, pattern

# Numbers of a servo without given gains
FULL_EFFORT_ERROR = {mujoco.mjtJoint.mjJNT_HINGE: 1.0, mujoco.mjtJoint.mjJNT_SLIDE: 0.05}
"""Position error at which it gives its full effort [rad, m]."""
FULL_EFFORT_SPEED = 10.0
"""Speed error at which the servo of a wheel gives its full effort [rad/s]."""
SERVO_FREQUENCY, SERVO_DAMPING_RATIO = 10.0, 2.0
"""Servo on a known rotor inertia: natural frequency [Hz] and damping ratio."""
ACTION_EFFORT_SHARE = 0.25
"""Share of the effort limit that action 1 requests from rest."""
ACTION_RANGE = 0.25
"""Action 1 of a servo without effort limit [rad, m]."""

ServoCfg = NativePositionActuatorCfg | NativeVelocityActuatorCfg
"""Servo of a joint, with empty `target_names_expr`."""


@dataclass(frozen=True, kw_only=True)
class Drives:
  """All that moves a robot."""

  servos: dict[str, ServoCfg]
  """By joint."""
  guessed: frozenset[str]
  """Joints whose stiffness is a guess, because only the effort is known."""
  kept: tuple[XmlActuatorCfg, ...]
  """Actuators that stay as the file has them."""
  replaced: frozenset[str]
  """Actuators of the file that servos replace."""

  def stiffer(self, factor: float) -> "Drives":
    """Return the same with guessed stiffness times `factor`, and damping to match."""
    servos = dict(self.servos)
    for joint in self.guessed:
      servo = servos[joint]
      gains = {"stiffness": factor * servo.stiffness, "damping": factor**0.5 * servo.damping}  # type: ignore
      servos[joint] = replace(servo, **gains)
    return replace(self, servos=servos)

  def configs(self) -> tuple[ActuatorCfg, ...]:
    """Return actuator configs; servos of equal numbers are one."""
    groups: dict[str, list[str]] = {}
    for joint, servo in self.servos.items():
      groups.setdefault(repr(servo), []).append(joint)
    made = [
      replace(self.servos[joints[0]], target_names_expr=tuple(map(pattern, joints))) for joints in groups.values()
    ]
    return (*made, *self.kept)

  def action_scale(self, joint: str) -> float:
    """Return the shift of the target of a joint per unit of action [rad, m]."""
    servo = self.servos[joint]
    effort, stiffness = servo.effort_limit, getattr(servo, "stiffness", 0.0)
    return min(1.0, ACTION_EFFORT_SHARE * effort / stiffness) if effort and stiffness else ACTION_RANGE  # type: ignore


def read_drives(robot: RobotModel, motors: Sequence[str], wheels: Sequence[str]) -> Drives:
  """Return servos for the joints of a robot.

  A joint takes the motor data of the user; else the actuator of the file, which a servo replaces if it is a position
  or velocity servo or a motor; else its effort limit, if no joint has an actuator.

  Args:
    robot: The robot.
    motors: PATTERN=EFFORT[,ARMATURE[,SPEED]] of the user.
    wheels: Joints without range that end at the ground: their motors become velocity servos.

  Raises:
    UsageError: Motor data cannot be read, or names no joint.
    MjlabError: No joint has an effort limit.
  """
  model, order = robot.compiled(), [joint.name for joint in robot.joints]
  given = robot.numbers(
    motors, "--motors", "PATTERN=EFFORT[,ARMATURE[,SPEED]] with positive numbers", most=3, above=0.0
  )
  servos: dict[str, ServoCfg] = {}
  guessed: set[str] = set()

  def add_motor(joint: str, *data: float) -> None:
    servos[joint] = _motor(model, joint, joint in wheels, *data)
    if len(data) == 1 and joint not in wheels:
      guessed.add(joint)

  for joint, data in given.items():
    add_motor(joint, *data)
  kept: dict[tuple[str, str], XmlActuatorCfg] = {}
  replaced: set[str] = set()
  for i, actuator in enumerate(robot.spec.actuators):
    name, target = actuator.name, actuator.target
    kind = actuator.trntype.name.removeprefix("mjTRN_").lower()
    if kind not in ("joint", "tendon", "site") or (kind == "joint" and target not in order):
      raise MjlabError(f"actuator '{printable(name)}' drives neither a hinge nor a slide, tendon or site; remove it")
    servo = _servo_of(model, i, target) if kind == "joint" and target not in servos else None
    if isinstance(servo, ServoCfg):
      servos[target] = servo
    elif servo is not None:
      add_motor(target, servo)
    elif kind != "joint" or target not in given:
      kept[target, kind] = XmlActuatorCfg(target_names_expr=(pattern(target),), transmission_type=kind)
      continue
    replaced.add(name)
  if not (servos or kept):
    for joint in order:
      if effort := _joint_effort(model, joint):
        add_motor(joint, effort)
  if not (servos or kept):
    joints = ", ".join(map(printable, order[:12]))
    raise MjlabError(f"{robot.source}: no joint has an actuator or an effort limit; give --motors. Joints: {joints}")
  targets = [target for target, _ in kept]
  if passive := [name for name in order if name not in (*servos, *targets)]:
    robot.notes.append(f"passive joints: {', '.join(map(printable, passive[:12]))}")
  if targets:
    robot.notes.append(f"kept as in the file: actuators of {', '.join(map(printable, targets[:12]))}")
  return Drives(
    servos={name: servos[name] for name in order if name in servos},
    guessed=frozenset(guessed),
    kept=tuple(kept.values()),
    replaced=frozenset(replaced),
  )


def _servo_of(model: mujoco.MjModel, i: int, joint: str) -> ServoCfg | float | None:
  """Return the servo that stands for an actuator of the file, the effort of a motor, or None for anything else."""
  gain, bias, gear = model.actuator_gainprm[i], model.actuator_biasprm[i], abs(model.actuator_gear[i, 0])
  is_plain = (
    model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_FIXED
    and model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_NONE
    and gain[0] > 0
    and gear > 0
  )
  if not is_plain:
    return None
  limits = [_joint_effort(model, joint)]
  if model.actuator_forcelimited[i]:
    limits.append(float(np.abs(model.actuator_forcerange[i]).max()) * gear)
  is_motor = model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE
  if is_motor and model.actuator_ctrllimited[i]:
    limits.append(float(gain[0] * np.abs(model.actuator_ctrlrange[i]).max()) * gear)
  effort = min((limit for limit in limits if limit), default=None)
  if is_motor:
    return effort
  if model.actuator_biastype[i] != mujoco.mjtBias.mjBIAS_AFFINE:
    return None
  stiffness, damping = gain[0] * gear**2, -bias[2] * gear**2
  if bias[1] == -gain[0]:
    return NativePositionActuatorCfg(target_names_expr=(), stiffness=stiffness, damping=damping, effort_limit=effort)
  if bias[1] == 0.0 and bias[2] == -gain[0]:
    return NativeVelocityActuatorCfg(target_names_expr=(), damping=damping, effort_limit=effort)
  return None


def _joint_effort(model: mujoco.MjModel, joint: str) -> float | None:
  i = model.joint(joint).id
  limit = float(np.abs(model.jnt_actfrcrange[i]).max())
  return limit if model.jnt_actfrclimited[i] and limit > 0 else None


def _motor(
  model: mujoco.MjModel,
  joint: str,
  is_wheel: bool,
  effort: float,
  armature: float | None = None,
  speed: float | None = None,
) -> ServoCfg:
  """Return the servo of a motor from its data."""
  if is_wheel:
    damping = effort / FULL_EFFORT_SPEED
    return NativeVelocityActuatorCfg(target_names_expr=(), damping=damping, effort_limit=effort, armature=armature)
  if armature is not None:
    stiffness, damping = gains_from_frequency(armature, SERVO_FREQUENCY, SERVO_DAMPING_RATIO)
  else:
    i = model.joint(joint).id
    stiffness = effort / FULL_EFFORT_ERROR[mujoco.mjtJoint(model.jnt_type[i])]
    # Critically damped on the limb that it moves.
    damping = 2.0 * float(np.sqrt(stiffness * model.dof_M0[model.jnt_dofadr[i]]))
  return NativePositionActuatorCfg(
    target_names_expr=(),
    stiffness=stiffness,
    damping=damping,
    effort_limit=effort,
    armature=armature,
    velocity_limit=speed,
  )
