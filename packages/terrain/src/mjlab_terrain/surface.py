"""Heights of the surface of solids, without MuJoCo."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from mjlab_terrain.solids import EDGE, Floats, Solid


def surface(solids: Sequence[Solid], x: Floats, y: Floats) -> Floats:
  """Return the height of the highest surface at the grid of `x` (nx,) and `y` (ny,), both ascending, (nx, ny) [m].

  It is -inf beside all solids. Rays straight down in MuJoCo hit the same heights.
  """
  top = np.full((len(x), len(y)), -np.inf)
  for solid in solids:
    low, high = solid.low, solid.high
    i = slice(*np.searchsorted(x, (low[0] - EDGE, high[0] + EDGE)))
    j = slice(*np.searchsorted(y, (low[1] - EDGE, high[1] + EDGE)))
    np.maximum(top[i, j], solid.top(x[i], y[j]), out=top[i, j])
  return top


def lowest_points(solids: Sequence[Solid], size: tuple[float, float]) -> tuple[float, float]:
  """Return the lowest height of the surface over a tile of this size, centred, and the lowest along its rim [m].

  Solids below the surface do not count. The result is exact except between boxes that are turned, which are sampled
  every 5 cm.
  """
  axes = []
  for axis, extent in enumerate(size):
    reach = 0.5 * extent
    points = np.concatenate((np.arange(-reach, reach, 0.05), [reach], *(solid.ticks(axis) for solid in solids)))
    points = np.unique(np.round(points, 7))
    axes.append(points[np.abs(points) <= reach + EDGE])
  z = surface(solids, *axes)
  return float(z.min()), float(min(z[[0, -1]].min(), z[:, [0, -1]].min()))


def over_disc(z: Floats, radius: float, spacing: float, reduce: np.ufunc) -> Floats:
  """Return `reduce` (`np.maximum` or `np.minimum`) over the points of a grid within `radius` of each.

  Points of the grid are `spacing` apart. The result lacks `num_steps(radius, spacing)` points on each side of `z`.
  """
  reach = num_steps(radius, spacing)
  nx, ny = np.subtract(z.shape, 2 * reach)
  steps = np.arange(-reach, reach + 1)
  near = np.argwhere(np.hypot(*np.meshgrid(steps, steps)) * spacing <= radius + 1e-9)
  return functools.reduce(reduce, (z[i : i + nx, j : j + ny] for i, j in near))


def num_steps(length: float, spacing: float) -> int:
  """Return the number of whole steps in a length."""
  return int(length / spacing + 1e-9)
