"""Heights of the surface of solids, without MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.solids import EDGE, Box, Floats, HeightField, Prism, Solid


def surface(solids: Sequence[Solid], x: Floats, y: Floats) -> Floats:
  """Return the height of the highest surface at the grid of `x` (nx,) and `y` (ny,), both ascending, (nx, ny) [m].

  It is -inf where there is nothing. A ray that falls down in MuJoCo hits the same heights.
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
    ends = np.array((-0.5, 0.5)) * extent
    edges = np.unique(np.concatenate([ends, *((s.low[axis], s.high[axis]) for s in solids)]))
    # Upright boxes are level between their edges, prisms are lowest at their corners, height fields at their vertices.
    at = [ends, 0.5 * (edges[1:] + edges[:-1])]
    at += [np.array((s.low[axis] + 1e-6, s.high[axis] - 1e-6)) for s in solids if isinstance(s, Prism)]
    fields = [s for s in solids if isinstance(s, HeightField)]
    at += [np.linspace(s.low[axis], s.high[axis], s.heights.shape[axis]) for s in fields]
    if any(isinstance(s, Box) and s.rotation is not None for s in solids):
      at.append(np.arange(ends[0], ends[1], 0.05))
    points = np.unique(np.round(np.concatenate(at), 7))
    axes.append(points[np.abs(points) <= ends[1] + EDGE])
  z = surface(solids, *axes)
  return float(z.min()), float(min(z[[0, -1]].min(), z[:, [0, -1]].min()))


def disc(radius: float, spacing: float) -> NDArray[np.int64]:
  """Return the offsets of all points of a grid of this spacing within `radius` of one of them, (n, 2)."""
  reach = int(radius / spacing + 1e-9)
  i, j = np.meshgrid(*[np.arange(-reach, reach + 1)] * 2, indexing="ij")
  inside = np.hypot(i, j) * spacing <= radius + 1e-9
  return np.stack((i[inside], j[inside]), axis=-1)


def over_disc(z: Floats, offsets: NDArray[np.int64], reduce: np.ufunc) -> Floats:
  """Return `reduce` (`np.maximum` or `np.minimum`) over the offsets around each point, (nx, ny).

  Points beyond the rim of `z` do not count.
  """
  reach = int(np.abs(offsets).max(initial=0))
  padded = np.pad(z, reach, constant_values=-np.inf if reduce is np.maximum else np.inf)
  out = z.copy()
  for i, j in offsets + reach:
    reduce(out, padded[i : i + z.shape[0], j : j + z.shape[1]], out=out)
  return out
