"""Level ground, columns and scattered boxes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.checked_fields import drawn, number, scaled
from mjlab_terrain.solids import FLAT, GROUND_DEPTH, MIN_THICKNESS, Interval
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

  def cells(self, tile: Tile, pitch: float) -> tuple[list[Interval], list[Interval]]:
    """Return the intervals along x and y of as many equal cells as fit, each at least `pitch` wide [m]."""
    x, y = (np.linspace(-0.5 * s, 0.5 * s, int(s / pitch + 1e-9) + 1).tolist() for s in tile.inner(self.border))
    return list(pairwise(x)), list(pairwise(y))


def in_platform(x: list[Interval], y: list[Interval], platform: float) -> NDArray[np.bool_]:
  """Return a mask of the cells with their centre on a central square of edge `platform`, (cells_x, cells_y).

  Each axis has at least one such cell, or two if the number of cells is even, unless `platform` is 0.
  """
  inside = []
  for cells in (x, y):
    low, high = np.transpose(cells)
    inside.append((0.5 * np.abs(low + high) <= 0.5 * max(platform, high[0] - low[0]) + 1e-9) & (platform > 0.0))
  return inside[0][:, None] & inside[1][None, :]


@dataclass(kw_only=True)
class RandomGridCfg(_ColumnsCfg):
  """Square columns of random heights around a level platform. Harder: larger differences."""

  height: tuple[float, float] = scaled((0.0, 0.3), harder="more")
  """Largest height of a column above or below the rim [m]."""
  cell: float = number(0.4, least=MIN_THICKNESS, inside=True)
  """Least edge of a column [m]; columns are as wide as needed to fill the tile."""
  levels: int | None = number(None, least=2, whole=True)
  """Number of different heights; neighbours of equal height become one geom. None allows all heights."""
  holes: bool = False
  """True leaves only a cross as wide as the platform, with a pit between its arms."""
  pit_depth: float = number(2.0, least=MIN_THICKNESS)
  """Depth of the pit below the rim [m]."""

  def build(self, tile: Tile) -> None:
    height = tile.scaled(self.height)
    x, y = self.cells(tile, self.cell)
    shape = len(x), len(y)
    if self.levels is None:
      unit = tile.rng.uniform(-1.0, 1.0, shape)
    else:
      unit = np.linspace(-1.0, 1.0, self.levels)[tile.rng.integers(self.levels, size=shape)]
    unit[in_platform(x, y, self.platform)] = 0.0
    if height < FLAT and not self.holes:
      tile.slab()
      return
    bottom, kept = -height - GROUND_DEPTH, np.ones(shape, dtype=bool)
    if self.holes:
      bottom = -self.pit_depth
      tile.slab(bottom)
      # Only rows and columns of the platform remain, at least those of one cell each.
      middle = in_platform(x, y, max(self.platform, self.cell))
      kept = middle.any(axis=1, keepdims=True) | middle.any(axis=0, keepdims=True)
    tile.ring(0.0, self.border, (bottom, 0.0))
    for i, j in np.argwhere(kept):
      tile.box(x[i], y[j], (bottom, height * float(unit[i, j])))


@dataclass(kw_only=True)
class RandomBoxesCfg(BorderedTileCfg):
  """Boxes of random size scattered over level ground, turned at random. Harder: more and higher boxes."""

  num_boxes: tuple[int, int] = scaled((40, 80), harder="more")
  """Number of boxes; boxes on the platform are left out."""
  width: tuple[float, float] = drawn((0.1, 1.0), least=MIN_THICKNESS)
  """Width of a box [m]."""
  length: tuple[float, float] = drawn((0.1, 2.0), least=MIN_THICKNESS)
  """Length of a box [m]."""
  height: tuple[float, float] = drawn((0.05, 0.3))
  """Height of a box above the ground [m], before it is scaled."""
  scale: tuple[float, float] = scaled((0.2, 1.0), harder="more")
  """Factor on the height of all boxes."""
  yaw: tuple[float, float] = drawn((0.0, 360.0), least=-360.0, most=360.0)
  """Angle about the vertical [deg]."""
  platform: float = number(1.0)
  """Edge of the square in the middle that stays free [m]."""

  def check(self, name: str, size: tuple[float, float]) -> None:
    super().check(name, size)
    room = min(size) - 2.0 * self.border
    diagonal = math.hypot(self.width[1], self.length[1])
    if diagonal > room:
      most = math.floor(100.0 * room / math.sqrt(2.0)) / 100.0
      self.refuse(
        name,
        f"the largest box has a diagonal of {diagonal:.3g} m, but there are {room:g} m inside the border; "
        f"width and length of at most {most:g} m would work",
      )

  def build(self, tile: Tile) -> None:
    # The same random numbers at any difficulty: an easier tile has the same boxes, only fewer and lower ones.
    most = round(max(self.num_boxes))
    half = 0.5 * np.stack([tile.rng.uniform(*ends, most) for ends in (self.width, self.length)], axis=-1)
    tops = tile.rng.uniform(*self.height, most) * tile.scaled(self.scale)
    yaw = np.radians(tile.rng.uniform(*self.yaw, most))
    cos, sin = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
    reach = np.stack((cos * half[:, 0] + sin * half[:, 1], sin * half[:, 0] + cos * half[:, 1]), -1)
    at = tile.rng.uniform(-1.0, 1.0, (most, 2)) * (0.5 * np.array(tile.inner(self.border)) - reach)
    tile.slab()
    for k in range(round(tile.scaled(self.num_boxes))):
      if tops[k] >= FLAT and overlap_free(at[k], half[k], float(yaw[k]), 0.5 * self.platform):
        x, y = np.stack((at[k] - half[k], at[k] + half[k]), axis=-1).tolist()
        tile.box(x, y, (-MIN_THICKNESS, float(tops[k])), yaw=float(yaw[k]))


def overlap_free(center: NDArray[np.float64], half: NDArray[np.float64], yaw: float, square: float) -> bool:
  """Return True if a rectangle turned by `yaw` [rad] stays clear of a square of half edge `square` [m] around zero.

  The separating axes are those of the square and those of the rectangle.
  """
  axes = np.array([[1.0, 0.0], [0.0, 1.0], [np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
  reach = np.abs(axes @ axes[2]) * half[0] + np.abs(axes @ axes[3]) * half[1] + np.abs(axes).sum(1) * square
  return bool((np.abs(axes @ center) >= reach).any())


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
    tilt, height = math.radians(tile.scaled(self.tilt)), tile.scaled(self.height)
    x, y = self.cells(tile, self.cell)
    shape = len(x), len(y)
    slopes = np.tan(tile.rng.uniform(-1.0, 1.0, (*shape, 2)) * tilt)
    tops = tile.rng.uniform(-0.5, 0.5, shape) * height
    if height < FLAT and tilt < FLAT:
      tile.slab()
      return
    on_platform = in_platform(x, y, self.platform)
    slopes[on_platform], tops[on_platform] = 0.0, 0.0
    fall = 0.5 * (np.abs(slopes) @ (x[0][1] - x[0][0], y[0][1] - y[0][0]))
    bottom = float((tops - fall).min()) - GROUND_DEPTH
    tile.ring(0.0, self.border, (bottom, 0.0))
    for i, j in np.ndindex(*shape):
      tile.box(x[i], y[j], (bottom, float(tops[i, j])), slope=tuple(slopes[i, j].tolist()))
