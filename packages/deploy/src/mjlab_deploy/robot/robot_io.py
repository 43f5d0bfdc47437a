"""The interface between the runner and a robot."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, kw_only=True)
class RobotInfo:
  """Properties of a robot, read before anything moves."""

  joint_names: tuple[str, ...]
  """Joints in the order of all arrays."""
  rate: float
  """Messages per second [Hz]."""
  stiffness: tuple[float, ...] | None = None
  """Gains that the drives are fixed to [N m/rad]; None: they take those of each command."""
  damping: tuple[float, ...] | None = None
  """Damping that the drives are fixed to [N m s/rad]; None: that of each command."""
  readings: tuple[str, ...] = ()
  """Inputs beyond joints and IMU that the robot supplies, such as "estimate/linear_velocity"."""


@dataclass(frozen=True, kw_only=True)
class RobotState:
  """Measurements of one message."""

  time: float
  """Time of the measurement [s], on the clock of the runner."""
  sequence: int
  """Number of the message, one more than that of the message before."""
  position: np.ndarray
  """Joint positions [rad]."""
  velocity: np.ndarray
  """Joint velocities [rad/s]."""
  gyro: np.ndarray
  """Angular velocity in the frame of the IMU, (3,) [rad/s]."""
  orientation: np.ndarray
  """Orientation of the root in the world, quaternion (w, x, y, z)."""
  readings: dict[str, np.ndarray] = field(default_factory=dict)
  """Other inputs by name."""


@dataclass(frozen=True, kw_only=True)
class RobotCommand:
  """Command of one message: effort = kp (position - q) + kd (0 - q')."""

  position: np.ndarray
  """Targets [rad]."""
  stiffness: np.ndarray
  """kp [N m/rad]; 0 in damping."""
  damping: np.ndarray
  """kd [N m s/rad]."""


class RobotIO(ABC):
  """A robot: `read` its newest state, `write` a command."""

  @abstractmethod
  def info(self) -> RobotInfo:
    """Return the properties of the robot."""

  @abstractmethod
  def read(self) -> RobotState | None:
    """Return the newest state; None if none has arrived yet. It does not wait."""

  @abstractmethod
  def write(self, command: RobotCommand) -> None:
    """Send a command."""
