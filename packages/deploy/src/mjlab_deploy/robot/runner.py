"""State machine that drives a robot by a policy, and switches to damping if anything is wrong."""

import math
from collections.abc import Iterator, Mapping
from itertools import zip_longest
from typing import Literal

import numpy as np

from mjlab_deploy.bundle import Bundle
from mjlab_deploy.errors import DeployError
from mjlab_deploy.policy import Policy
from mjlab_deploy.robot.motion import MotionPlayer
from mjlab_deploy.robot.robot_io import RobotCommand, RobotIO, RobotState
from mjlab_deploy.robot.safety import Safety, SafetyLimits

Phase = Literal["damping", "stand", "policy"]

_MEASURED = ("joint/position", "joint/velocity", "imu/gyro", "imu/projected_gravity")
_HOLDING, _MOST_HELD = 8.0, 0.3
"""Rate at which targets of a fixed robot move against its sag while it stands [1/s], and their greatest move [rad]."""
_DAMPING = 2.0
"""kd of a joint in damping whose drive has none in the bundle [N m s/rad]."""


class Runner:
  """State machine: damping, stand, policy, and damping again. Call `tick` with every message of the robot.

  Args:
    bundle: The bundle.
    robot: The robot.
    limits: Limits; None: the standard ones.
    stand_time: Time to reach the default pose [s].

  Raises:
    DeployError: The robot's joints, gains or rate are not the bundle's, or it lacks a reading of the policy.
  """

  def __init__(
    self, bundle: Bundle, robot: RobotIO, limits: SafetyLimits | None = None, *, stand_time: float = 2.0
  ) -> None:
    self.description = bundle.description
    self.robot, self.policy = robot, Policy(bundle)
    self.motion = MotionPlayer(bundle) if self.description.motion is not None else None
    if problem := next(self._problems(), ""):
      raise DeployError(f"refused: {problem}")
    described = self.description.robot
    self._default = described.values("default_position")
    self._stiffness, self._damping = described.values("stiffness"), described.values("damping", _DAMPING)
    self._columns = [described.joint_names.index(name) for name in self.description.targets[0].joints]
    self.safety = Safety(self.description, limits or SafetyLimits())
    self.phase: Phase = "damping"
    """Present phase."""
    self.reason = "not started"
    """Reason for damping."""
    sizes = {item.name: math.prod(item.shape) for item in self.description.inputs}
    self.command = {item.input: np.zeros(sizes[item.input]) for item in self.description.commands}
    """Commands of the operator by input; write into the arrays, values are limited to the ranges of the training."""
    self.targets = self._default.copy()
    """Newest joint targets [rad]."""
    self._stand_time = stand_time
    self._sequence: int | None = None
    self._phase_start = self._next_step = self._now = 0.0
    self._from = self._default
    self._held = np.zeros_like(self._default)

  def _problems(self) -> Iterator[str]:
    """Yield a line for each reason not to move the robot."""
    info, robot, timing = self.robot.info(), self.description.robot, self.description.timing
    for i, (ours, theirs) in enumerate(zip_longest(robot.joint_names, info.joint_names, fillvalue="missing")):
      if ours != theirs:
        yield f"joint {i} is '{ours}' in the bundle and '{theirs}' on the robot"
    for gain in ("stiffness", "damping"):
      for joint, value in zip(robot.joints, getattr(info, gain) or (), strict=False):
        wanted = getattr(joint, gain)
        if joint.is_driven and wanted is not None and not math.isclose(value, wanted, rel_tol=1e-3):
          yield f"{gain} of '{joint.name}' is {wanted:g} in the bundle and {value:g} on the robot"
    if info.rate * timing.control_dt < 0.999:
      yield f"the policy runs at {1.0 / timing.control_dt:g} Hz, the robot sends {info.rate:g} messages a second"
    if [target.quantity for target in self.description.targets] != ["position"]:
      yield "the policy sets other targets than positions, which the runner does not drive"
    if missing := [joint.name for joint in robot.joints if joint.is_driven and joint.stiffness is None]:
      yield f"the bundle has no stiffness of joint '{missing[0]}'"
    known = {*_MEASURED, *info.readings, *(item.input for item in self.description.commands)}
    known |= set(self.motion.readings()) if self.motion is not None else set()
    if unknown := [item.name for item in self.description.inputs if item.name not in known]:
      yield f"the robot does not supply {', '.join(unknown)}; train a policy without it"

  def start(self) -> None:
    """Leave damping: stand up, then run the policy.

    Raises:
      DeployError: No state has arrived.
    """
    state = self.robot.read()
    if state is None:
      raise DeployError("the robot sends no state")
    self.safety.reset()
    self._sequence = state.sequence
    self._from = state.position.copy()
    self.targets = state.position.copy()
    self._enter("stand", state.time)

  def stop(self, reason: str = "stopped by the operator") -> None:
    """Switch to damping from any phase."""
    self.reason = reason
    self.phase = "damping"
    self._write(self.targets, 0.0)

  def tick(self, now: float) -> Phase:
    """Read the newest state, check it, and send a command; return the phase.

    Args:
      now: Present time on the clock of the robot's states [s].
    """
    try:
      self._tick(now)
    except Exception as error:
      # A failure must not leave the robot with its last command.
      self.stop(f"{type(error).__name__}: {error}")
    return self.phase

  def _tick(self, now: float) -> None:
    state = self.robot.read()
    if self.phase == "damping":
      self._write(self.targets, 0.0)
      return
    if state is None or now - state.time > self.safety.limits.stale_after:
      self.stop(f"no state for {now - state.time:.3f} s" if state is not None else "no state")
      return
    if state.sequence != self._sequence:
      self._sequence = state.sequence
      if (problem := self.safety.check_message(state)) is not None:
        self.stop(problem)
        return
    if self.phase == "stand":
      self._stand(now, state)
    else:
      self._run_policy(now, state)

  def _stand(self, now: float, state: RobotState) -> None:
    share = min((now - self._phase_start) / max(self._stand_time, 1e-6), 1.0)
    self.targets = self._from + share * (self._default - self._from)
    if not self.description.robot.is_floating:
      # Gravity pulls an arm below its targets, but its policy begins in the default pose.
      step = share * _HOLDING * min(now - self._now, 0.02)
      self._held = np.clip(self._held + step * (self.targets - state.position), -_MOST_HELD, _MOST_HELD)
      self.targets = self.targets + self._held
    self._now = now
    # Gains grow within the first half, so that nothing jumps.
    self._write(self.safety.limited(self.targets, self.targets, state), min(2.0 * share, 1.0))
    if share >= 1.0:
      self.policy.reset()
      if self.motion is not None:
        self.motion.reset()
        body, given = self.motion.anchor_body, state.readings
        position = given.get(f"estimate/{body}/position", np.zeros(3))
        self.motion.align(position, given.get(f"imu/{body}/orientation", state.orientation))
      self._enter("policy", now)

  def _run_policy(self, now: float, state: RobotState) -> None:
    if now + 1e-9 >= self._next_step:
      self._next_step += self.description.timing.control_dt
      # Steps missed in a pause are skipped.
      self._next_step = max(self._next_step, now + 0.5 * self.description.timing.control_dt)
      step = self.policy.step(self._readings(state))
      wanted = step.targets[self.description.targets[0].name]
      if not np.isfinite(wanted).all():
        self.stop("the policy's action is not finite")
        return
      targets = self._default.copy()
      targets[self._columns] = wanted
      self.targets = self.safety.limited(targets, self.targets, state)
      if self.motion is not None:
        self.motion.advance()
    self._write(self.targets, 1.0)

  def _readings(self, state: RobotState) -> Mapping[str, np.ndarray]:
    w, x, y, z = state.orientation
    readings = {
      "joint/position": state.position,
      "joint/velocity": state.velocity,
      "imu/gyro": state.gyro,
      "imu/projected_gravity": -np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)]),
    }
    for item in self.description.commands:
      value = self.command[item.input].astype(float)
      for i, limits in zip(range(len(value)), item.ranges.values(), strict=False):
        value[i] = np.clip(value[i], *limits)
      readings[item.input] = value
    if self.motion is not None:
      readings |= self.motion.readings()
    return readings | state.readings

  def _enter(self, phase: Phase, now: float) -> None:
    self.phase, self.reason = phase, ""
    self._phase_start = self._next_step = self._now = now
    self._held[:] = 0.0

  def _write(self, targets: np.ndarray, gain: float) -> None:
    self.robot.write(
      RobotCommand(position=targets.copy(), stiffness=gain * self._stiffness, damping=self._damping.copy())
    )
