"""Flat places on a tile, for objects or feet."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.checked_fields import check_fields, drawn, number, refuse
from mjlab_terrain.surface import num_steps, over_disc, surface
from mjlab_terrain.tile import Tile

EVERYWHERE = (-math.inf, math.inf)


@dataclass(kw_only=True)
class FlatPatchCfg:
  """Round places of nearly level ground; they may overlap."""

  count: int = number(10, least=1)
  """Number of places on each tile."""
  radius: float = number(0.5, least=0.01)
  """Radius of a place [m]; a place is entirely on its tile."""
  max_height_difference: float = number(0.05)
  """Largest difference between the highest and the lowest point of a place [m]."""
  x_range: tuple[float, float] = drawn(EVERYWHERE, least=-math.inf)
  """Range of centres along x, from the tile's centre [m]."""
  y_range: tuple[float, float] = drawn(EVERYWHERE, least=-math.inf)
  """Range of centres along y, from the tile's centre [m]."""
  z_range: tuple[float, float] = drawn(EVERYWHERE, least=-math.inf)
  """Range of heights of centres [m]."""
  resolution: float = number(0.05, least=0.01)
  """Distance between the points at which the ground is sampled [m]."""

  def check(self, name: str, size: tuple[float, float]) -> None:
    """Check that a tile of this size has room for such places; `name` is their name in messages.

    Raises:
      ValueError: it has none, or a setting is out of its range.
    """
    check_fields(self, name)
    tile = f"a tile of {size[0]:g} x {size[1]:g} m"
    if self.radius > 0.5 * min(size):
      fits = f"at most {0.5 * min(size):g} m would work"
      refuse(self, name, f"radius {self.radius:g} m does not fit into {tile}; {fits}")
    for axis, (low, high) in enumerate((self.x_range, self.y_range)):
      reach = 0.5 * size[axis] - self.radius
      if low > reach or high < -reach:
        where = f"centres can be from {-reach:g} to {reach:g} m on {tile}"
        refuse(self, name, f"{'xy'[axis]}_range ({low:g}, {high:g}) has no room; {where}")

  def find(self, tile: Tile, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return centres of places drawn at random, on the surface, in the tile's frame, to `resolution`, (count, 3) [m].

    If a tile has fewer places, they repeat; if it has none, all are at the most level place.
    """
    spacing, around = self.resolution, num_steps(self.radius, self.resolution)
    axes = []
    for (low, high), extent in zip((self.x_range, self.y_range), tile.size, strict=True):
      reach = 0.5 * extent - self.radius
      # Centres are multiples of the resolution; if none is in the range, the nearest one.
      ends = np.clip((low, high), -reach, reach) / spacing
      first, last = math.ceil(ends[0] - 1e-9), math.floor(ends[1] + 1e-9)
      if first > last:
        first = last = round(ends.mean())
      axes.append(spacing * np.arange(first - around, last + around + 1))
    heights = surface(tile.solids, *axes)
    highest, lowest = (over_disc(heights, self.radius, spacing, reduce) for reduce in (np.maximum, np.minimum))
    difference = highest - lowest
    x, y = (axis[around : len(axis) - around] for axis in axes)
    z = heights[around : around + len(x), around : around + len(y)]
    found = np.argwhere((difference <= self.max_height_difference) & (self.z_range[0] <= z) & (z <= self.z_range[1]))
    if not len(found):
      found = np.transpose(np.unravel_index([difference.argmin()], z.shape))
    i, j = found[rng.permutation(len(found))[np.arange(self.count) % len(found)]].T
    return np.stack((x[i], y[j], z[i, j]), axis=-1)
