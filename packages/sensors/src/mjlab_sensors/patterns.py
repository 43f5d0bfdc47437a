"""Where the rays of a frame start and where they point."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import floor, inf

import mujoco
import numpy as np


@dataclass(kw_only=True, frozen=True)
class RayPatternCfg(ABC):
  """A fixed set of rays in the coordinates of a frame."""

  @abstractmethod
  def rays(self) -> tuple[np.ndarray, np.ndarray]:
    """Starting points and unit directions in the frame, both (num_rays, 3), float64 [m]."""

  def resolve(self, model: mujoco.MjModel) -> RayPatternCfg:
    """The pattern with what it leaves to the compiled model filled in."""
    del model
    return self


def _downward(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
  starts = np.concatenate((points, np.zeros((len(points), 1))), axis=1)
  return starts, np.tile((0.0, 0.0, -1.0), (len(points), 1))


@dataclass(kw_only=True, frozen=True)
class RingPatternCfg(RayPatternCfg):
  """Rays straight down from a circle around the frame; the first sample lies on the x axis, the others follow
  counter-clockwise."""

  radius: float = 0.1
  """Radius of the circle [m]."""
  num_samples: int = 8
  """Number of rays on the circle."""
  include_center: bool = True
  """Put one more ray, the first, at the frame itself."""

  def __post_init__(self) -> None:
    if not 0.0 < self.radius < inf or self.num_samples < 0 or self.num_samples + self.include_center < 1:
      raise ValueError(f"RingPatternCfg: needs a positive radius and at least one ray, not {self}")

  def rays(self) -> tuple[np.ndarray, np.ndarray]:
    angle = 2.0 * np.pi * np.arange(self.num_samples) / max(self.num_samples, 1)
    ring = self.radius * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    return _downward(np.concatenate((np.zeros((int(self.include_center), 2)), ring)))


@dataclass(kw_only=True, frozen=True)
class LidarPatternCfg(RayPatternCfg):
  """Rays from one point through a field of view of equal angles, row by row from the top, each from left to right.

  It is the order of an image: ray `row * columns + column`. Angle 0 looks along the frame's x axis, y is to its left
  and z up. Rows and columns reach both ends of their field of view, but a full turn of columns does not come to the
  same ray twice; a single row or column looks through the middle.
  """

  rows: int = 16
  """Rows, or channels."""
  columns: int = 64
  """Rays of each row."""
  vertical_fov: tuple[float, float] = (-15.0, 15.0)
  """Lowest and highest angle above the horizontal plane of the frame [deg]."""
  horizontal_fov: tuple[float, float] = (-180.0, 180.0)
  """Rightmost and leftmost angle, counted to the left from the frame's x axis [deg]."""

  def __post_init__(self) -> None:
    if min(self.rows, self.columns) < 1:
      raise ValueError(f"LidarPatternCfg: needs at least one row and one column, not {self.rows} and {self.columns}")
    low, high = self.vertical_fov
    if not -90.0 <= low <= high <= 90.0:
      raise ValueError(f"LidarPatternCfg: vertical_fov must rise from -90 to 90 degrees, not {self.vertical_fov}")
    right, left = self.horizontal_fov
    if not (-360.0 <= right <= left <= 360.0 and left - right <= 360.0):
      raise ValueError(f"LidarPatternCfg: horizontal_fov must rise by at most 360 degrees, not {self.horizontal_fov}")

  def rays(self) -> tuple[np.ndarray, np.ndarray]:
    full_turn = self.horizontal_fov[1] - self.horizontal_fov[0] == 360.0
    elevation = np.radians(_spread(*self.vertical_fov, self.rows, full_turn=False))[::-1, None]
    azimuth = np.radians(_spread(*self.horizontal_fov, self.columns, full_turn=full_turn))[::-1]
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    directions = np.stack((x, y, np.broadcast_to(np.sin(elevation), x.shape)), axis=-1).reshape(-1, 3)
    return np.zeros_like(directions), directions


def _spread(low: float, high: float, count: int, *, full_turn: bool) -> np.ndarray:
  if count == 1:
    return np.array([(low + high) / 2.0])
  # The leftmost ray of a full turn would be the rightmost one again.
  return np.linspace(low, high, count + full_turn)[int(full_turn) :]


@dataclass(kw_only=True, frozen=True)
class GridPatternCfg(RayPatternCfg):
  """Rays straight down from a grid centred on the frame; x runs fastest, both from negative to positive.

  A side holds as many steps as fit: (1.6, 1.0) at 0.1 is 17 x 11 rays, 1.0 at 0.3 is -0.45, -0.15, 0.15, 0.45.
  """

  size: tuple[float, float] = (1.0, 1.0)
  """Sides along x and y [m]."""
  resolution: float = 0.1
  """Distance between neighbours [m]."""

  def __post_init__(self) -> None:
    if not 0.0 < self.resolution < inf or len(self.size) != 2 or not all(0.0 <= side < inf for side in self.size):
      raise ValueError(f"GridPatternCfg: needs a positive resolution and two sides of at least 0, not {self}")

  def rays(self) -> tuple[np.ndarray, np.ndarray]:
    x, y = (self._side(length) for length in self.size)
    return _downward(np.stack([axis.ravel() for axis in np.meshgrid(x, y)], axis=1))

  def _side(self, length: float) -> np.ndarray:
    # 1.6 / 0.1 is a little less than 16 in binary; the slack is far below a step.
    steps = floor(length / self.resolution + 1e-6)
    return (np.arange(steps + 1) - steps / 2) * self.resolution
