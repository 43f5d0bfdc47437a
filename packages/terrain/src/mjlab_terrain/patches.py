"""Flat places on a tile, for objects or feet."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.checked_fields import check_fields, drawn, number, refuse
from mjlab_terrain.surface import over_disc, surface
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
    # An even number of steps, so that the middle of the tile is among the points.
    axes = [np.linspace(-0.5 * s, 0.5 * s, 2 * max(math.ceil(0.5 * s / self.resolution), 1) + 1) for s in tile.size]
    z = surface(tile.solids, *axes)
    # The grid is square enough that the finer of its two spacings covers the radius in both.
    spacing = min(a[1] - a[0] for a in axes)
    highest, lowest = (over_disc(z, self.radius, spacing, reduce) for reduce in (np.maximum, np.minimum))
    difference = highest - lowest
    inside = []
    for at, (low, high), extent in zip(axes, (self.x_range, self.y_range), tile.size, strict=True):
      reach = 0.5 * extent - self.radius
      low, high = max(-reach, low), min(reach, high)
      there = (low - 1e-9 <= at) & (at <= high + 1e-9)
      # If no point of the grid is in the range, the nearest is.
      there[np.argmin(np.abs(at - 0.5 * (low + high)))] |= not there.any()
      inside.append(there)
    allowed = np.logical_and.outer(*inside)
    good = allowed & (difference <= self.max_height_difference) & (self.z_range[0] <= z) & (z <= self.z_range[1])
    found = np.argwhere(good)
    if len(found):
      chosen = found[rng.permutation(len(found))[np.arange(self.count) % len(found)]]
    else:
      flattest = np.where(allowed, difference, np.inf)
      chosen = np.repeat([np.unravel_index(np.argmin(flattest), z.shape)], self.count, axis=0)
    i, j = chosen.T
    return np.stack((axes[0][i], axes[1][j], z[i, j]), axis=-1)
