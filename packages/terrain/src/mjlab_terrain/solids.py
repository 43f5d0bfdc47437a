"""Solids of the ground: boxes with level or sloping tops, and height fields."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

MIN_THICKNESS = 0.05
"""Least extent of a geom in any direction [m]. Contact solvers miss thinner geoms."""

GROUND_DEPTH = 1.0
"""Depth of the ground below its lowest surface [m]."""

FLAT = 1e-3
"""Least height of a feature [m]. Lower features are left out."""

EDGE = 1e-9
"""Points closer to an edge than this belong to the solid [m]."""

Interval = tuple[float, float]
Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class SolidBase(ABC):
  """Part of the ground over a rectangle, with vertical sides and a level bottom."""

  center: Floats
  """Middle of its top, in the frame of its tile, (3,) [m]."""
  half: tuple[float, float]
  """Half of its extent along its own x and y [m]."""
  bottom: float
  """Height of its bottom [m]."""
  kind: int = 0
  """Index of the type of its tile."""

  @cached_property
  def reach(self) -> Floats:
    """Half of its extent along x and y of the tile, (2,) [m]."""
    return np.array(self.half)

  @property
  def is_plain(self) -> bool:
    """True if it is a box with sides along the axes of the tile and a level top."""
    return False

  @property
  @abstractmethod
  def top_range(self) -> Interval:
    """Lowest and highest point of its top above `center` [m]."""

  @abstractmethod
  def top(self, x: Floats, y: Floats) -> Floats:
    """Return its height at the grid of points `x` (nx,) and `y` (ny,) inside its bounds, (nx, ny) [m].

    The height is -inf beside the solid.
    """

  @cached_property
  def low(self) -> Floats:
    """Lowest corner of its bounds, (3,) [m]."""
    return np.array((*(self.center[:2] - self.reach), self.bottom))

  @cached_property
  def high(self) -> Floats:
    """Highest corner of its bounds, (3,) [m]."""
    return np.array((*(self.center[:2] + self.reach), self.center[2] + self.top_range[1]))

  @property
  def thickness(self) -> float:
    """Least extent, including that between bottom and the lowest point of the top [m]."""
    return float(np.min((*np.multiply(self.half, 2.0), self.center[2] + self.top_range[0] - self.bottom)))

  def ticks(self, axis: int) -> Floats:
    """Return coordinates along an axis where the surface may be lowest: both sides of each edge, (n,) [m]."""
    edges = np.array((self.low[axis], self.high[axis]))
    return np.concatenate((edges - 1e-6, edges + 1e-6))


@dataclass(frozen=True, kw_only=True, eq=False)
class Box(SolidBase):
  """Upright box with a level or sloping top."""

  slope: tuple[float, float] = (0.0, 0.0)
  """Rise of its top along its own x and y [1]."""
  yaw: float = 0.0
  """Angle about the vertical from the axes of the tile to its own [rad]."""

  @property
  def is_plain(self) -> bool:
    return not self.yaw and not any(self.slope)

  @property
  def top_range(self) -> Interval:
    rise = float(np.dot(np.abs(self.slope), self.half))
    return -rise, rise

  @cached_property
  def axes(self) -> Floats:
    """Its own x and y axes as columns, in the frame of its tile, (2, 2)."""
    cos, sin = np.cos(self.yaw), np.sin(self.yaw)
    return np.array(((cos, -sin), (sin, cos)))

  @cached_property
  def reach(self) -> Floats:
    return np.abs(self.axes) @ self.half

  @property
  def corners(self) -> Floats:
    """Corners: four pairs, each of a bottom corner and the top corner above it, (8, 3) [m]."""
    own = np.array([(x, y) for x in (-1, 1) for y in (-1, 1)]) * self.half
    out = np.repeat(np.column_stack((self.center[:2] + own @ self.axes.T, own @ self.slope)), 2, axis=0)
    out[::2, 2], out[1::2, 2] = self.bottom, out[1::2, 2] + self.center[2]
    return out

  def top(self, x: Floats, y: Floats) -> Floats:
    (cos, _), (sin, _) = self.axes
    x, y = x[:, None] - self.center[0], y[None, :] - self.center[1]
    along, across = cos * x + sin * y, cos * y - sin * x
    inside = (np.abs(along) <= self.half[0] + EDGE) & (np.abs(across) <= self.half[1] + EDGE)
    return np.where(inside, self.center[2] + self.slope[0] * along + self.slope[1] * across, -np.inf)


def box_between(x: Interval, y: Interval, z: Interval, **fields: Any) -> Box:
  """Return a box between bounds [m], with other fields of a `Box`; z is the bottom and the middle of the top."""
  center, half = np.array((0.5 * sum(x), 0.5 * sum(y), z[1])), (0.5 * (x[1] - x[0]), 0.5 * (y[1] - y[0]))
  return Box(center=center, half=half, bottom=z[0], **fields)


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightField(SolidBase):
  """Surface given at the vertices of a regular grid, and solid below."""

  heights: Floats
  """Height of each vertex above `center`, first index along x, second along y, (nx, ny) [m]."""

  @property
  def top_range(self) -> Interval:
    return float(self.heights.min()), float(self.heights.max())

  def ticks(self, axis: int) -> Floats:
    vertices = np.linspace(self.low[axis], self.high[axis], self.heights.shape[axis])
    return np.append(super().ticks(axis), vertices)

  def top(self, x: Floats, y: Floats) -> Floats:
    # The height on the two triangles that MuJoCo cuts each cell into.
    cells = []
    for axis, at in enumerate((x, y)):
      last = self.heights.shape[axis] - 1
      place = np.clip((at - self.low[axis]) / (self.high[axis] - self.low[axis]) * last, 0.0, last)
      index = np.minimum(place.astype(np.int64), last - 1)
      cells.append((index, place - index))
    (i, u), (j, v) = cells
    i, u = i[:, None], u[:, None]
    h = self.center[2] + self.heights
    near, far = h[i, j], h[i + 1, j + 1]
    # The diagonal runs from the corner with the lowest x and y to that with the highest.
    below = near + u * (h[i + 1, j] - near) + v * (far - h[i + 1, j])
    above = near + v * (h[i, j + 1] - near) + u * (far - h[i, j + 1])
    return np.where(u >= v, below, above)


Solid = Box | HeightField
