"""Level ground, columns and scattered boxes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mjlab_terrain.checked_fields import drawn, number, scaled
from mjlab_terrain.solids import FLAT, GROUND_DEPTH, MIN_THICKNESS, Floats
from mjlab_terrain.tile import Tile
from mjlab_terrain.tile_cfg import BorderedTileCfg, TileCfg


@dataclass(kw_only=True)
class FlatCfg(TileCfg):
  """Level ground. Difficulty has no effect."""

  def build(self, tile: Tile) -> None:
    tile.slab()


@dataclass(kw_only=True)
class _ColumnsCfg(BorderedTileCfg):
  """Square columns around a level platform."""

  platform: float = number(1.0)
  """Edge of the level platform [m], in whole columns."""
  cell: float = number(0.4, least=MIN_THICKNESS, inside=True)
  """Least edge of a column [m]; columns are as wide as needed to fill the tile."""

  def counts(self, tile: Tile) -> tuple[int, int]:
    """Return the number of columns along x and y."""
    x, y = tile.inner(self.border)
    return int(x / self.cell + 1e-9), int(y / self.cell + 1e-9)

  def add_columns(self, tile: Tile, tops: Floats, slopes: Floats, pit_depth: float | None = None) -> None:
    """Add columns with tops (nx, ny) [m] and slopes (nx, ny, 2) [1], and the border.

    With `pit_depth` [m], only a cross as wide as the platform remains, at least one column, and a pit around it.
    """
    edges = [np.linspace(-0.5 * s, 0.5 * s, n + 1) for s, n in zip(tile.inner(self.border), tops.shape, strict=True)]
    # Columns with their centre on the platform: at least one, or two if their number is even.
    middle = [np.abs(e[1:] + e[:-1]) <= max(self.platform, e[1] - e[0]) + 2e-9 for e in edges]
    if self.platform > 0.0:
      tops[np.ix_(*middle)], slopes[np.ix_(*middle)] = 0.0, 0.0
    fall = 0.5 * np.abs(slopes) @ [e[1] - e[0] for e in edges]
    bottom, kept = float((tops - fall).min()) - GROUND_DEPTH, np.ones_like(tops)
    if pit_depth is not None:
      bottom, kept = -pit_depth, np.logical_or.outer(*middle)
      tile.slab(bottom)
    elif (np.abs(tops) + fall).max() < FLAT:
      tile.slab()
      return
    tile.ring(0.0, self.border, (bottom, 0.0))
    x, y = (list(pairwise(e.tolist())) for e in edges)
    for i, j in np.argwhere(kept):
      tile.box(x[i], y[j], (bottom, float(tops[i, j])), slope=tuple(slopes[i, j].tolist()))


@dataclass(kw_only=True)
class RandomGridCfg(_ColumnsCfg):
  """Square columns of random heights around a level platform. Harder: larger differences."""

  height: tuple[float, float] = scaled((0.0, 0.3), harder="more")
  """Largest height of a column above or below the rim [m]."""
  levels: int | None = number(None, least=2, whole=True)
  """Number of different heights; neighbours of equal height become one geom. None allows all heights."""
  holes: bool = False
  """True leaves only a cross as wide as the platform, with a pit between its arms."""
  pit_depth: float = number(2.0, least=MIN_THICKNESS)
  """Depth of the pit below the rim [m]."""

  def build(self, tile: Tile) -> None:
    counts = self.counts(tile)
    if self.levels is None:
      unit = tile.rng.uniform(-1.0, 1.0, counts)
    else:
      unit = np.linspace(-1.0, 1.0, self.levels)[tile.rng.integers(self.levels, size=counts)]
    pit_depth = self.pit_depth if self.holes else None
    self.add_columns(tile, tile.scaled(self.height) * unit, np.zeros((*counts, 2)), pit_depth)


@dataclass(kw_only=True)
class TiltedGridCfg(_ColumnsCfg):
  """Square columns with sloping tops around a level platform. Harder: steeper and more uneven.

  Sides are vertical, so that nothing can get under the edge of a column.
  """

  tilt: tuple[float, float] = scaled((0.0, 15.0), harder="more", most=40.0)
  """Largest slope of a top along x and along y [deg]."""
  height: tuple[float, float] = scaled((0.0, 0.1), harder="more")
  """Largest difference between the middles of tops [m]."""
  cell: float = number(1.0, least=0.2, inside=True)
  """Least edge of a column [m]; columns are as wide as needed to fill the tile."""

  def build(self, tile: Tile) -> None:
    counts = self.counts(tile)
    tilts = tile.rng.uniform(-1.0, 1.0, (*counts, 2)) * math.radians(tile.scaled(self.tilt))
    tops = tile.rng.uniform(-0.5, 0.5, counts) * tile.scaled(self.height)
    self.add_columns(tile, tops, np.tan(tilts))


@dataclass(kw_only=True)
class RandomBoxesCfg(BorderedTileCfg):
  """Boxes of random size scattered over level ground, turned at random. Harder: more and higher boxes."""

  num_boxes: tuple[int, int] = scaled((40, 80), harder="more")
  """Number of boxes; boxes that are close to the platform or reach over the border are left out."""
  width: tuple[float, float] = drawn((0.1, 1.0), least=MIN_THICKNESS, inside=True)
  """Width of a box [m]."""
  length: tuple[float, float] = drawn((0.1, 2.0), least=MIN_THICKNESS, inside=True)
  """Length of a box [m]."""
  height: tuple[float, float] = drawn((0.05, 0.3))
  """Height of a box above the ground [m], before it is scaled."""
  scale: tuple[float, float] = scaled((0.2, 1.0), harder="more")
  """Factor on the height of all boxes."""
  yaw: tuple[float, float] = drawn((0.0, 360.0), least=-360.0, most=360.0)
  """Angle about the vertical [deg]."""
  platform: float = number(1.0)
  """Edge of the square in the middle that stays free [m]."""

  def build(self, tile: Tile) -> None:
    # The same random numbers at any difficulty: an easier tile has the same boxes, only fewer and lower ones.
    most = round(max(self.num_boxes))
    half = 0.5 * np.stack([tile.rng.uniform(*ends, most) for ends in (self.width, self.length)], axis=-1)
    tops = tile.rng.uniform(*self.height, most) * tile.scaled(self.scale)
    yaw = np.radians(tile.rng.uniform(*self.yaw, most))
    cos, sin = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
    # Half of the extent of the turned box along the axes of the tile.
    reach = np.stack((cos * half[:, 0] + sin * half[:, 1], sin * half[:, 0] + cos * half[:, 1]), -1)
    room = 0.5 * np.array(tile.inner(self.border)) - reach
    at = tile.rng.uniform(-1.0, 1.0, (most, 2)) * room
    kept = (np.abs(at) >= reach + 0.5 * self.platform).any(-1) & (room >= 0.0).all(-1) & (tops >= FLAT)
    kept[round(tile.scaled(self.num_boxes)) :] = False
    tile.slab()
    for k in np.flatnonzero(kept):
      x, y = np.stack((at[k] - half[k], at[k] + half[k]), axis=-1).tolist()
      tile.box(x, y, (-MIN_THICKNESS, float(tops[k])), yaw=float(yaw[k]))
