"""Limits under which a policy may drive a robot."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from mjlab_deploy.description import Description
from mjlab_deploy.robot.robot_io import RobotState


@dataclass(frozen=True, kw_only=True)
class SafetyLimits:
  """Limits of the runner; those of joints come from the bundle."""

  stale_after: float = 0.012
  """Age of the newest state at which the policy ends [s]."""
  frozen_messages: int = 4
  """Messages in a row with bit-equal joints and IMU that mean a frozen sensor; real ones have noise."""
  loss: float = 0.05
  """Share of lost messages, in a window of `loss_window`, at which the policy ends."""
  loss_window: int = 100
  """Messages over which losses are counted."""
  tilt: float = 1.0
  """Largest angle between the root's z axis and the vertical [rad]."""
  position_margin: float = 0.1
  """Largest distance of a measured joint outside of its range [rad]."""
  velocity_factor: float = 1.5
  """Share of a joint's velocity limit at which the policy ends."""


class Safety:
  """Checks of states and targets.

  Args:
    description: Contents of `bundle.json`.
    limits: Limits.
  """

  def __init__(self, description: Description, limits: SafetyLimits) -> None:
    self.limits = limits
    robot = description.robot
    self._names, self._is_floating = robot.joint_names, robot.is_floating
    ranges = [joint.position_range or (-math.inf, math.inf) for joint in robot.joints]
    self._low, self._high = np.array(ranges, dtype=float).reshape(-1, 2).T
    self._speed, effort = robot.values("velocity_limit", math.inf), robot.values("effort_limit", math.inf)
    kp, damping = robot.values("stiffness"), robot.values("damping")
    with np.errstate(divide="ignore", invalid="ignore"):
      # Beyond this distance the servo is saturated.
      self._reach = np.where(kp > 0.0, effort / kp, math.inf)
      self._brake = np.where(kp > 0.0, damping / kp, 0.0)
    self._largest_step = 2.0 * self._reach + self._speed * description.timing.control_dt
    self.reset()

  def reset(self) -> None:
    """Forget earlier messages."""
    self._same, self._last = 0, np.empty(0)
    self._sequence: int | None = None
    self._losses: deque[bool] = deque(maxlen=self.limits.loss_window)

  def check_message(self, state: RobotState) -> str | None:
    """Return the reason for which a new message ends the policy; None if it does not."""
    limits = self.limits
    seen = np.concatenate((state.position, state.velocity, state.gyro, state.orientation))
    if not np.isfinite(seen).all():
      return "a measurement is not finite"
    self._same = self._same + 1 if np.array_equal(seen, self._last) else 0
    self._last = seen
    if self._same >= limits.frozen_messages:
      return f"sensors are frozen: {self._same + 1} equal messages"
    missed = 0 if self._sequence is None else state.sequence - self._sequence - 1
    if missed < 0:
      return "messages come in the wrong order"
    self._losses.extend([True] * min(missed, limits.loss_window) + [False])
    self._sequence = state.sequence
    lost = sum(self._losses)
    # The share is of a full window, so that one message lost at the start does not count as many.
    if lost >= limits.loss * limits.loss_window:
      return f"{lost} of the last {len(self._losses)} messages were lost"
    return self._check_limits(state)

  def _check_limits(self, state: RobotState) -> str | None:
    limits = self.limits
    if self._is_floating:
      _, x, y, _ = state.orientation / max(float(np.linalg.norm(state.orientation)), 1e-9)
      tilt = math.acos(min(max(1.0 - 2.0 * (x * x + y * y), -1.0), 1.0))
      if tilt > limits.tilt:
        return f"tilted by {tilt:.2f} rad, more than {limits.tilt:g}"
    outside = np.maximum(self._low - state.position, state.position - self._high)
    if (worst := int(np.argmax(outside))) >= 0 and outside[worst] > limits.position_margin:
      return f"joint '{self._names[worst]}' is {outside[worst]:.2f} rad outside of its range"
    over = np.abs(state.velocity) - limits.velocity_factor * self._speed
    if (worst := int(np.argmax(over))) >= 0 and over[worst] > 0.0:
      return f"joint '{self._names[worst]}' moves at {state.velocity[worst]:.1f} rad/s"
    return None

  def limited(self, targets: np.ndarray, before: np.ndarray, state: RobotState) -> np.ndarray:
    """Return targets within joint ranges, torque limits and the largest step from the targets before."""
    targets = np.clip(targets, before - self._largest_step, before + self._largest_step)
    # kp (target - q) - kd q' stays within the effort limit.
    centre = state.position + self._brake * state.velocity
    targets = np.clip(targets, centre - self._reach, centre + self._reach)
    return np.clip(targets, self._low, self._high)
