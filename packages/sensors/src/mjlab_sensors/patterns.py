"""Patterns of rays: starting points and directions in the coordinates of a frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from math import floor
from typing import Annotated, Literal

import mujoco
import numpy as np
from mjlab_core import (
  Ascending,
  Config,
  Count,
  Limits,
  NonNegative,
  Positive,
  PositiveCount,
  check_fields,
)


@dataclass(kw_only=True, frozen=True)
class RayPatternCfg(Config, ABC):
  """Fixed set of rays in the coordinates of a frame."""

  def __post_init__(self) -> None:
    check_fields(self, type(self).__name__, self.problems())

  def problems(self) -> Iterator[str]:
    """Yield the mistakes in fields that fit their annotations."""
    yield from ()

  @abstractmethod
  def rays(self) -> tuple[np.ndarray, np.ndarray]:
    """Return starting points and unit directions in the frame, both (num_rays, 3), float64 [m]."""

  def resolve(self, model: mujoco.MjModel) -> RayPatternCfg:
    """Return the pattern with all values that come from the compiled model."""
    del model
    return self


def _downward(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
  starts = np.concatenate((points, np.zeros((len(points), 1))), axis=1)
  return starts, np.tile((0.0, 0.0, -1.0), (len(points), 1))


@dataclass(kw_only=True, frozen=True)
class RingPatternCfg(RayPatternCfg):
  """Rays straight down from a circle around the frame, counter-clockwise; the first sample is on the x axis."""

  radius: Positive = 0.1
  """Radius of the circle [m]."""
  num_samples: Count = 8
  """Number of rays on the circle."""
  include_center: bool = True
  """Add a ray at the frame itself, before the others."""

  def problems(self) -> Iterator[str]:
    if self.num_samples + self.include_center < 1:
      yield "num_samples must be at least 1 without include_center, got 0"

  def rays(self) -> tuple[np.ndarray, np.ndarray]:
    angle = 2.0 * np.pi * np.arange(self.num_samples) / max(self.num_samples, 1)
    ring = self.radius * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    return _downward(np.concatenate((np.zeros((int(self.include_center), 2)), ring)))


@dataclass(kw_only=True, frozen=True)
class LidarPatternCfg(RayPatternCfg):
  """Rays from one point through a field of view of equal angles, row by row from the top, each from left to right.

  The order is that of an image: ray `row * columns + column`. Angle 0 is along the frame's x axis, with y to the left
  and z up. Rows and columns reach both ends of their field of view, but a full turn has no ray twice. A single row or
  column looks through the middle.
  """

  rows: PositiveCount = 16
  """Rows, or channels."""
  columns: PositiveCount = 64
  """Rays of each row."""
  vertical_fov: Annotated[tuple[float, float], Limits(ge=-90, le=90), Ascending()] = (-15.0, 15.0)
  """Lowest and highest angle above the horizontal plane of the frame [deg]."""
  horizontal_fov: Annotated[tuple[float, float], Limits(ge=-360, le=360), Ascending()] = (-180.0, 180.0)
  """Rightmost and leftmost angle from the frame's x axis, positive to the left [deg]."""

  def problems(self) -> Iterator[str]:
    right, left = self.horizontal_fov
    if left - right > 360.0:
      yield f"horizontal_fov must span at most 360 degrees, got {self.horizontal_fov}"

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
  """Parallel rays from a grid centred on the frame: straight down, or forward along the frame's x axis.

  In a downward grid x runs fastest, then y; in a forward grid y, then z; all from negative to positive.

  A side holds as many steps as fit: (1.6, 1.0) at 0.1 is 17 x 11 rays, 1.0 at 0.3 is -0.45, -0.15, 0.15, 0.45.
  """

  size: tuple[NonNegative, NonNegative] = (1.0, 1.0)
  """Sides along x and y, or y and z of a forward grid [m]."""
  resolution: Positive = 0.1
  """Distance between neighbours [m]."""
  direction: Literal["down", "forward"] = "down"

  def rays(self) -> tuple[np.ndarray, np.ndarray]:
    sides = (self._side(length) for length in self.size)
    points = np.stack([axis.ravel() for axis in np.meshgrid(*sides)], axis=1)
    if self.direction == "down":
      return _downward(points)
    starts = np.concatenate((np.zeros((len(points), 1)), points), axis=1)
    return starts, np.tile((1.0, 0.0, 0.0), (len(points), 1))

  def _side(self, length: float) -> np.ndarray:
    # 1.6 / 0.1 is a little less than 16 in binary; the slack is far below a step.
    steps = floor(length / self.resolution + 1e-6)
    return (np.arange(steps + 1) - steps / 2) * self.resolution
