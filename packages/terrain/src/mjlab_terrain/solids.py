"""Solids of the ground: boxes, prisms with a sloping top, and height fields."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

MIN_THICKNESS = 0.05
"""Least extent of a geom in any direction [m]; contact solvers lose thinner ones."""

GROUND_DEPTH = 1.0
"""Depth of the ground below its lowest surface [m]."""

FLAT = 1e-3
"""Least height of a feature [m]; a lower one is left out."""

EDGE = 1e-9
"""Points this close to an edge belong to the solid [m]."""

Interval = tuple[float, float]
Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
  """Box of any orientation."""

  center: Floats
  """In the frame of its tile, (3,) [m]."""
  half: Floats
  """Half of its extent along its own axes, (3,) [m]."""
  rotation: Floats | None = None
  """Its axes as columns, in the frame of its tile, (3, 3); None if they are those of the tile."""

  @cached_property
  def extent(self) -> Floats:
    """Half of its extent along the axes of the tile, (3,) [m]."""
    return self.half if self.rotation is None else np.abs(self.rotation) @ self.half

  @cached_property
  def low(self) -> Floats:
    """Lowest corner of its bounds, (3,) [m]."""
    return self.center - self.extent

  @cached_property
  def high(self) -> Floats:
    """Highest corner of its bounds, (3,) [m]."""
    return self.center + self.extent

  @property
  def thickness(self) -> float:
    """Least extent [m]."""
    return 2.0 * float(self.half.min())

  @property
  def color_height(self) -> float:
    """Height that its color shows [m]."""
    return float(self.high[2])

  def top(self, x: Floats, y: Floats) -> Floats:
    """Return its height at the grid of points `x` (nx,) and `y` (ny,), (nx, ny) [m]; -inf where it has none."""
    if self.rotation is None:
      return np.full((len(x), len(y)), self.high[2])
    around = np.meshgrid(x - self.center[0], y - self.center[1], indexing="ij")
    start, up = np.stack((*around, np.zeros((len(x), len(y)))), -1) @ self.rotation, self.rotation[2]
    enter = np.full(start.shape[:2], -np.inf)
    leave = np.full(start.shape[:2], np.inf)
    for axis in range(3):
      if abs(up[axis]) < 1e-12:
        leave = np.where(np.abs(start[..., axis]) > self.half[axis] + EDGE, -np.inf, leave)
      else:
        ends = (np.array([-1.0, 1.0]) * self.half[axis] - start[..., axis, None]) / up[axis]
        enter = np.maximum(enter, ends.min(-1))
        leave = np.minimum(leave, ends.max(-1))
    return np.where(leave >= enter - EDGE, self.center[2] + leave, -np.inf)

  def moved(self, by: Floats) -> Box:
    """Return the box moved by (3,) [m]."""
    return replace(self, center=self.center + by)

  def deepened(self, bottom: float) -> Box:
    """Return the box with its bottom no higher than this height [m]; a box that is tilted stays as it is."""
    low, high = self.low, self.high
    tilted = self.rotation is not None and abs(self.rotation[2, 2]) < 1.0 - 1e-9
    if tilted or low[2] <= bottom:
      return self
    half = 0.5 * (high[2] - bottom)
    return replace(self, center=np.array((*self.center[:2], high[2] - half)), half=np.array((*self.half[:2], half)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Prism:
  """Upright prism over a rectangle; its top is a plane, its sides are vertical."""

  center: Floats
  """Middle of its top, in the frame of its tile, (3,) [m]."""
  half: tuple[float, float]
  """Half of its extent along x and y [m]."""
  slope: tuple[float, float]
  """Rise of its top along x and y [1]."""
  bottom: float
  """Height of its bottom [m]."""

  @cached_property
  def corners(self) -> Floats:
    """Corners, for each of four the one at the bottom and the one at the top, (8, 3) [m]."""
    out = []
    for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
      at = x * self.half[0], y * self.half[1]
      xy = self.center[:2] + at
      out += [(*xy, self.bottom), (*xy, self.center[2] + np.dot(self.slope, at))]
    return np.array(out)

  @cached_property
  def low(self) -> Floats:
    """Lowest corner of its bounds, (3,) [m]."""
    return np.array((*(self.center[:2] - self.half), self.bottom))

  @cached_property
  def high(self) -> Floats:
    """Highest corner of its bounds, (3,) [m]."""
    return np.array((*(self.center[:2] + self.half), self.center[2] + np.abs(self.slope) @ np.array(self.half)))

  @property
  def thickness(self) -> float:
    """Least extent, between the lowest point of its top and its bottom too [m]."""
    return float(min(*(self.high - self.low)[:2], 2.0 * self.center[2] - self.high[2] - self.bottom))

  @property
  def color_height(self) -> float:
    """Height that its color shows [m]."""
    return float(self.center[2])

  def top(self, x: Floats, y: Floats) -> Floats:
    """Return its height at the grid of points `x` (nx,) and `y` (ny,) inside its bounds, (nx, ny) [m]."""
    x, y = x - self.center[0], y - self.center[1]
    return self.center[2] + self.slope[0] * x[:, None] + self.slope[1] * y[None, :]

  def moved(self, by: Floats) -> Prism:
    """Return the prism moved by (3,) [m]."""
    return replace(self, center=self.center + by, bottom=self.bottom + float(by[2]))

  def deepened(self, bottom: float) -> Prism:
    """Return the prism with its bottom no higher than this height [m]."""
    return replace(self, bottom=min(self.bottom, bottom))


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightField:
  """Surface over a rectangle, given at the vertices of a regular grid, and solid below."""

  heights: Floats
  """Height at each vertex, first index along x, second along y, (nx, ny) [m]."""
  x: Interval
  """Extent along x [m]."""
  y: Interval
  """Extent along y [m]."""
  bottom: float
  """Height of its bottom [m]."""

  @property
  def thickness(self) -> float:
    """Least extent [m]."""
    return float(self.heights.min()) - self.bottom

  @cached_property
  def low(self) -> Floats:
    """Lowest corner of its bounds, (3,) [m]."""
    return np.array((self.x[0], self.y[0], self.bottom))

  @cached_property
  def high(self) -> Floats:
    """Highest corner of its bounds, (3,) [m]."""
    return np.array((self.x[1], self.y[1], self.heights.max()))

  def top(self, x: Floats, y: Floats) -> Floats:
    """Return its height at the grid of points `x` (nx,) and `y` (ny,) inside its bounds, (nx, ny) [m].

    It is the height on the two triangles that MuJoCo cuts each cell into.
    """
    h = self.heights

    def cell(p: Floats, ends: Interval, num: int) -> tuple[NDArray[np.int64], Floats]:
      at = np.clip((p - ends[0]) / (ends[1] - ends[0]) * (num - 1), 0.0, num - 1.0)
      index = np.minimum(at.astype(np.int64), num - 2)
      return index, at - index

    i, u = cell(x, self.x, h.shape[0])
    j, v = cell(y, self.y, h.shape[1])
    i, u, j, v = i[:, None], u[:, None], j[None, :], v[None, :]
    near, far = h[i, j], h[i + 1, j + 1]
    # The diagonal runs from the corner with the lowest x and y to that with the highest.
    below = near + u * (h[i + 1, j] - near) + v * (far - h[i + 1, j])
    above = near + v * (h[i, j + 1] - near) + u * (far - h[i, j + 1])
    return np.where(u >= v, below, above)

  def moved(self, by: Floats) -> HeightField:
    """Return the height field moved by (3,) [m]."""
    (dx, dy, dz) = (float(d) for d in by)
    x, y = (self.x[0] + dx, self.x[1] + dx), (self.y[0] + dy, self.y[1] + dy)
    return HeightField(heights=self.heights + dz, x=x, y=y, bottom=self.bottom + dz)

  def deepened(self, bottom: float) -> HeightField:
    """Return the height field with its bottom no higher than this height [m]."""
    return replace(self, bottom=min(self.bottom, bottom))


Solid = Box | Prism | HeightField
