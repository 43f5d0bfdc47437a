"""Heights of the surface that boxes and height fields make, without MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
  from mjlab_terrain.tile import Box, HeightField

# Points on an edge belong to the solid.
_EDGE = 1e-9

Floats = NDArray[np.float64]


def surface(boxes: Sequence[Box], fields: Sequence[HeightField], x: Floats, y: Floats) -> Floats:
  """Height of the highest surface at all points of the grid of `x` (nx,) and `y` (ny,), both ascending, (nx, ny) [m].

  It is -inf where there is nothing. A ray that falls down in MuJoCo hits the same heights.
  """
  top = np.full((len(x), len(y)), -np.inf)
  for box in boxes:
    low, high = box.center - box.extent - _EDGE, box.center + box.extent + _EDGE
    i = slice(*np.searchsorted(x, (low[0], high[0])))
    j = slice(*np.searchsorted(y, (low[1], high[1])))
    here = box.center[2] + box.half[2] if box.rotation is None else _top_of_turned_box(box, x[i], y[j])
    np.maximum(top[i, j], here, out=top[i, j])
  for field in fields:
    i = slice(*np.searchsorted(x, (field.x[0] - _EDGE, field.x[1] + _EDGE)))
    j = slice(*np.searchsorted(y, (field.y[0] - _EDGE, field.y[1] + _EDGE)))
    np.maximum(top[i, j], _top_of_field(field, x[i], y[j]), out=top[i, j])
  return top


def _top_of_turned_box(box: Box, x: Floats, y: Floats) -> Floats:
  """Where vertical lines through the grid leave the box, (nx, ny) [m]; -inf where they miss it."""
  assert box.rotation is not None
  points = np.stack((*np.meshgrid(x - box.center[0], y - box.center[1], indexing="ij"), np.zeros((len(x), len(y)))), -1)
  start, up = points @ box.rotation, box.rotation[2]
  enter = np.full(start.shape[:2], -np.inf)
  leave = np.full(start.shape[:2], np.inf)
  for axis in range(3):
    if abs(up[axis]) < 1e-12:
      outside = np.abs(start[..., axis]) > box.half[axis] + _EDGE
      leave = np.where(outside, -np.inf, leave)
    else:
      ends = (np.array([-1.0, 1.0]) * box.half[axis] - start[..., axis, None]) / up[axis]
      enter = np.maximum(enter, ends.min(-1))
      leave = np.minimum(leave, ends.max(-1))
  return np.where(leave >= enter - _EDGE, box.center[2] + leave, -np.inf)


def _top_of_field(field: HeightField, x: Floats, y: Floats) -> Floats:
  """Height on the two triangles that MuJoCo cuts each cell into, (nx, ny) [m]."""
  h = field.heights

  def cell(p: Floats, ends: tuple[float, float], num: int) -> tuple[NDArray[np.int64], Floats]:
    at = np.clip((p - ends[0]) / (ends[1] - ends[0]) * (num - 1), 0.0, num - 1.0)
    index = np.minimum(at.astype(np.int64), num - 2)
    return index, at - index

  i, u = cell(x, field.x, h.shape[0])
  j, v = cell(y, field.y, h.shape[1])
  i, u, j, v = i[:, None], u[:, None], j[None, :], v[None, :]
  near, far = h[i, j], h[i + 1, j + 1]
  # The diagonal runs from the corner with the lowest x and y to that with the highest.
  below = near + u * (h[i + 1, j] - near) + v * (far - h[i + 1, j])
  above = near + v * (h[i, j + 1] - near) + u * (far - h[i, j + 1])
  return np.where(u >= v, below, above)


def disc(radius: float, spacing: float) -> NDArray[np.int64]:
  """Offsets of all points of a grid of this spacing within `radius` of one of them, (n, 2)."""
  reach = int(radius / spacing + 1e-9)
  i, j = np.meshgrid(*[np.arange(-reach, reach + 1)] * 2, indexing="ij")
  inside = np.hypot(i, j) * spacing <= radius + 1e-9
  return np.stack((i[inside], j[inside]), axis=-1)


def over_disc(z: Floats, offsets: NDArray[np.int64], reduce: np.ufunc) -> Floats:
  """`reduce` (`np.maximum` or `np.minimum`) over the offsets around each point, (nx, ny); points beyond the rim of `z`
  do not count."""
  reach = int(np.abs(offsets).max(initial=0))
  padded = np.pad(z, reach, constant_values=-np.inf if reduce is np.maximum else np.inf)
  out = z.copy()
  for i, j in offsets + reach:
    reduce(out, padded[i : i + z.shape[0], j : j + z.shape[1]], out=out)
  return out
