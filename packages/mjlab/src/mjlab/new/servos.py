"""Servos of a robot: read from the actuators of its file, from effort limits, or from motor data of the user."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import mujoco
import numpy as np
from mjlab_actuators import (
  ActuatorCfg,
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
  XmlActuatorCfg,
  gains_from_frequency,
)
from mjlab_core import MjlabError, UsageError, printable
from mjlab_core.names import match_names

from mjlab.new.model_file import RobotModel

# A servo whose gains nobody gives
FULL_EFFORT_ERROR = {mujoco.mjtJoint.mjJNT_HINGE: 1.0, mujoco.mjtJoint.mjJNT_SLIDE: 0.05}
"""Position error at which it gives its full effort [rad, m]."""
FULL_EFFORT_SPEED = 10.0
"""Speed error at which the servo of a wheel gives its full effort [rad/s]."""
SERVO_FREQUENCY, SERVO_DAMPING_RATIO = 10.0, 2.0
"""Servo on a known rotor inertia: natural frequency [Hz] and damping ratio."""
ACTION_EFFORT_SHARE = 0.25
"""Share of the effort limit that action 1 asks for from rest."""
ACTION_RANGE = 0.25
"""Action 1 of a servo without effort limit [rad, m]."""

Transmissions = {
  mujoco.mjtTrn.mjTRN_TENDON: "tendon",
  mujoco.mjtTrn.mjTRN_SITE: "site",
  mujoco.mjtTrn.mjTRN_JOINT: "joint",
}


MotorData = tuple[float, float | None, float | None]
"""Effort [N m or N], armature [kg m^2 or kg] and speed [rad/s or m/s] of a motor."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Servo:
  """Servo of one joint."""

  joint: str
  kind: Literal["position", "velocity"] = "position"
  stiffness: float = 0.0
  """[N m/rad or N/m]."""
  damping: float
  """[N m s/rad or N s/m]."""
  effort_limit: float | None = None
  velocity_limit: float | None = None
  armature: float | None = None
  is_guess: bool = False
  """True if only the effort is known."""

  @property
  def numbers(self) -> tuple[object, ...]:
    """All but the joint: servos of equal numbers are one group."""
    return (self.kind, self.stiffness, self.damping, self.effort_limit, self.velocity_limit, self.armature)

  @property
  def action_scale(self) -> float:
    """Shift of the target per unit of action [rad, m]."""
    if self.effort_limit is None or not self.stiffness:
      return ACTION_RANGE
    return min(1.0, ACTION_EFFORT_SHARE * self.effort_limit / self.stiffness)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drives:
  """All that moves a robot."""

  servos: tuple[Servo, ...]
  kept: tuple[tuple[str, str], ...] = ()
  """(transmission, target) of actuators that stay as the file has them."""
  replaced: frozenset[str] = frozenset()
  """Actuators of the file that servos replace."""

  def groups(self) -> list[tuple[Servo, ...]]:
    """Return servos of equal numbers together, in the order of joints."""
    found: dict[tuple[object, ...], list[Servo]] = {}
    for servo in self.servos:
      found.setdefault(servo.numbers, []).append(servo)
    return [tuple(group) for group in found.values()]

  def stiffer(self, factor: float) -> "Drives":
    """Return the same with guessed stiffness times `factor`, and damping to match."""
    servos = (
      dataclasses.replace(servo, stiffness=factor * servo.stiffness, damping=factor**0.5 * servo.damping)
      if servo.is_guess
      else servo
      for servo in self.servos
    )
    return dataclasses.replace(self, servos=tuple(servos))

  def configs(self) -> tuple[ActuatorCfg, ...]:
    """Return actuator configs."""
    made: list[ActuatorCfg] = []
    for group in self.groups():
      one, names = group[0], tuple(re.escape(servo.joint) for servo in group)
      same: dict[str, Any] = {name: getattr(one, name) for name in ("damping", "effort_limit", "armature")}
      if one.kind == "velocity":
        made.append(NativeVelocityActuatorCfg(target_names_expr=names, **same))
      else:
        limits: dict[str, Any] = {"stiffness": one.stiffness, "velocity_limit": one.velocity_limit}
        made.append(NativePositionActuatorCfg(target_names_expr=names, **same, **limits))
    for transmission, target in self.kept:
      made.append(XmlActuatorCfg(target_names_expr=(re.escape(target),), transmission_type=transmission))  # type: ignore
    return tuple(made)


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
  given = _motor_data(motors, order)
  servos, kept, replaced = _from_actuators(robot, model, given, wheels)
  for joint, data in given.items():
    servos[joint] = _motor(model, joint, *data, joint in wheels)
  if not servos and not kept:
    limits = {joint: _joint_effort(model, joint) for joint in order}
    servos = {
      joint: _motor(model, joint, effort, None, None, joint in wheels) for joint, effort in limits.items() if effort
    }
  if not servos and not kept:
    joints = ", ".join(map(printable, order[:12]))
    raise MjlabError(f"{robot.source}: no joint has an actuator or an effort limit; give --motors. Joints: {joints}")
  if passive := [name for name in order if name not in servos and ("joint", name) not in kept]:
    robot.notes.append(f"passive joints: {', '.join(map(printable, passive[:12]))}")
  if kept:
    robot.notes.append(f"kept as in the file: actuators of {', '.join(printable(target) for _, target in kept[:12])}")
  return Drives(
    servos=tuple(servos[name] for name in order if name in servos), kept=tuple(kept), replaced=frozenset(replaced)
  )


def _from_actuators(
  robot: RobotModel, model: mujoco.MjModel, given: Mapping[str, MotorData], wheels: Sequence[str]
) -> tuple[dict[str, Servo], list[tuple[str, str]], set[str]]:
  """Return servos of the actuators of the file, the actuators to keep, and those that servos or given data replace."""
  servos: dict[str, Servo] = {}
  kept: list[tuple[str, str]] = []
  replaced: set[str] = set()
  for i in range(model.nu):
    kind = mujoco.mjtTrn(model.actuator_trntype[i])
    name, target = model.actuator(i).name, robot.spec.actuators[i].target
    is_of_joint = kind == mujoco.mjtTrn.mjTRN_JOINT
    if kind not in Transmissions or (is_of_joint and not _is_single(model, target)):
      raise MjlabError(f"actuator '{printable(name)}' drives neither a hinge nor a slide, tendon or site; remove it")
    if is_of_joint and target in given:
      replaced.add(name)
    elif is_of_joint and target not in servos and (servo := _servo_of(model, i, target, target in wheels)) is not None:
      servos[target] = servo
      replaced.add(name)
    else:
      kept.append((Transmissions[kind], target))
  return servos, kept, replaced


def _motor_data(motors: Sequence[str], joints: list[str]) -> dict[str, MotorData]:
  found: dict[str, MotorData] = {}
  for text in motors:
    pattern, _, values = text.rpartition("=")
    try:
      numbers = [float(value) for value in values.split(",")]
    except ValueError:
      numbers = []
    if not 1 <= len(numbers) <= 3 or not all(np.isfinite(number) and number > 0 for number in numbers):
      raise UsageError(f"--motors: {text!r} must be PATTERN=EFFORT[,ARMATURE[,SPEED]] with positive numbers")
    armature, speed = (*numbers[1:], None, None)[:2]
    for name in match_names(pattern, joints, what="joint", owner="--motors")[1]:
      found[name] = (numbers[0], armature, speed)
  return found


def _servo_of(model: mujoco.MjModel, i: int, joint: str, is_wheel: bool) -> Servo | None:
  """Return the servo that stands for an actuator of the file; None if it is something else."""
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
  is_affine = model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_AFFINE
  if not is_affine and model.actuator_ctrllimited[i]:
    limits.append(float(gain[0] * np.abs(model.actuator_ctrlrange[i]).max()) * gear)
  effort = min((limit for limit in limits if limit), default=None)
  if is_affine and bias[1] == -gain[0]:
    return Servo(joint=joint, stiffness=gain[0] * gear**2, damping=-bias[2] * gear**2, effort_limit=effort)
  if is_affine and bias[1] == 0.0 and bias[2] == -gain[0]:
    return Servo(joint=joint, kind="velocity", damping=gain[0] * gear**2, effort_limit=effort)
  if model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE and effort:
    return _motor(model, joint, effort, None, None, is_wheel)
  return None


def _is_single(model: mujoco.MjModel, joint: str) -> bool:
  return mujoco.mjtJoint(model.jnt_type[model.joint(joint).id]) in FULL_EFFORT_ERROR


def _joint_effort(model: mujoco.MjModel, joint: str) -> float | None:
  i = model.joint(joint).id
  limit = float(np.abs(model.jnt_actfrcrange[i]).max())
  return limit if model.jnt_actfrclimited[i] and limit > 0 else None


def _motor(
  model: mujoco.MjModel, joint: str, effort: float, armature: float | None, speed: float | None, is_wheel: bool
) -> Servo:
  """Return the servo of a motor of which only data is known."""
  i = model.joint(joint).id
  if is_wheel:
    damping = effort / FULL_EFFORT_SPEED
    return Servo(joint=joint, kind="velocity", damping=damping, effort_limit=effort, armature=armature)
  if armature is not None:
    stiffness, damping = gains_from_frequency(armature, SERVO_FREQUENCY, SERVO_DAMPING_RATIO)
  else:
    stiffness = effort / FULL_EFFORT_ERROR[mujoco.mjtJoint(model.jnt_type[i])]
    # Critically damped on the limb that it moves.
    damping = 2.0 * float(np.sqrt(stiffness * model.dof_M0[model.jnt_dofadr[i]]))
  return Servo(
    joint=joint,
    stiffness=stiffness,
    damping=damping,
    effort_limit=effort,
    velocity_limit=speed,
    armature=armature,
    is_guess=armature is None,
  )
