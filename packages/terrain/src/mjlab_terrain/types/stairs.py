"""Stairs around the middle of a tile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjlab_terrain.checked_fields import drawn, number, scaled
from mjlab_terrain.solids import FLAT, GROUND_DEPTH, MIN_THICKNESS
from mjlab_terrain.tile import Tile
from mjlab_terrain.tile_cfg import BorderedTileCfg


def num_steps(extent: tuple[float, float], platform: float, step_width: float) -> int:
  """Return the number of steps that fit on each side of a platform inside this extent."""
  return max(int((min(extent) - platform) / (2.0 * step_width) + 1e-9), 0)


@dataclass(kw_only=True)
class PyramidStairsCfg(BorderedTileCfg):
  """Stairs on all four sides, up to a platform in the middle, or down to it. Harder: higher steps."""

  step_height: tuple[float, float] = scaled((0.0, 0.2), harder="more")
  """Rise of each step [m]."""
  step_width: float = number(0.3, least=MIN_THICKNESS)
  """Depth of each tread [m]."""
  platform: float = number(3.0, least=MIN_THICKNESS)
  """Edge of the platform [m]; it grows by what is left when no whole step fits any more."""
  border: float = number(1.0)
  """Width of the level rim [m]."""
  inverted: bool = False
  """True makes the stairs go down."""
  holes: bool = False
  """True leaves only four flights as wide as the platform, with a pit between them."""
  pit_depth: float = number(2.0, least=MIN_THICKNESS)
  """Depth of the pit below the lowest step [m]."""

  def build(self, tile: Tile) -> None:
    rise = tile.scaled(self.step_height)
    if rise < FLAT and not self.holes:
      tile.slab()
      return
    outer = np.array(tile.inner(self.border))
    n = num_steps(tile.inner(self.border), self.platform, self.step_width)
    up = -rise if self.inverted else rise
    lowest = min((n + 1) * up, 0.0)
    if self.holes:
      floor = lowest - self.pit_depth
      tile.slab(floor)
    else:
      floor = lowest - GROUND_DEPTH
    tile.frame(tile.size, tile.inner(self.border), (floor, 0.0))
    arms = self.platform if self.holes else None
    for k in range(n):
      extent, z = outer - 2.0 * k * self.step_width, (floor, (k + 1) * up)
      if self.inverted or self.holes:
        tile.frame(tuple(extent), tuple(extent - 2.0 * self.step_width), z, arms=arms)
      else:
        # Going up, each level lies on the one below: one box instead of four.
        tile.block(tuple(extent), z)
    tile.block(
      (self.platform, self.platform) if arms else tuple(outer - 2.0 * n * self.step_width), (floor, (n + 1) * up)
    )


@dataclass(kw_only=True)
class OpenStairsCfg(BorderedTileCfg):
  """Stairs of thin treads with open risers, on all four sides. Harder: higher and narrower steps.

  An open riser is a slot one tread deep, whose floor is level with the tread in front of it. A foot can slip under a
  tread, but it cannot fall.
  """

  step_height: tuple[float, float] = scaled((0.0, 0.2), harder="more")
  """Rise of each step [m]."""
  step_width: tuple[float, float] = scaled((0.8, 0.4), harder="less", least=MIN_THICKNESS)
  """Depth of each tread [m]."""
  step_thickness: float = number(MIN_THICKNESS, least=MIN_THICKNESS)
  """Thickness of each tread [m]."""
  platform: float = number(1.0, least=MIN_THICKNESS)
  """Edge of the platform [m]; it grows by what is left when no whole step fits any more."""
  inverted: bool = False
  """True makes the stairs go down."""

  def build(self, tile: Tile) -> None:
    rise, width = tile.scaled(self.step_height), tile.scaled(self.step_width)
    n = num_steps(tile.inner(self.border), self.platform, width)
    if rise < FLAT or n == 0:
      tile.slab()
      return
    outer = np.array(tile.inner(self.border))
    # Each tread lies one rise above solid stairs.
    floor = -n * rise if self.inverted else 0.0
    tile.slab(floor)
    if self.inverted:
      tile.frame(tile.size, tuple(outer), (floor - GROUND_DEPTH, 0.0))
    for k in range(n):
      extent = outer - 2.0 * k * width
      inner = tuple(extent - 2.0 * width)
      top = -k * rise if self.inverted else (k + 1) * rise
      tile.frame(tuple(extent), inner, (top - self.step_thickness, top))
      if not self.inverted and k > 0:
        tile.block(tuple(extent), (-GROUND_DEPTH, k * rise))
      elif self.inverted and k < n - 1:
        tile.frame(tuple(extent), inner, (floor - GROUND_DEPTH, top - rise))
    if not self.inverted:
      extent, top = tuple(outer - 2.0 * n * width), (n + 1) * rise
      tile.block(extent, (-GROUND_DEPTH, n * rise))
      tile.block(extent, (top - self.step_thickness, top))


@dataclass(kw_only=True)
class RandomStairsCfg(BorderedTileCfg):
  """Stairs up to a platform, each step of another height. Harder: higher steps."""

  step_height: tuple[float, float] = drawn((0.1, 0.3))
  """Rise of each step [m], before it is scaled."""
  scale: tuple[float, float] = scaled((0.0, 1.0), harder="more")
  """Factor on the rise of all steps."""
  step_width: float = number(0.8, least=MIN_THICKNESS)
  """Depth of each tread [m]."""
  platform: float = number(1.0, least=MIN_THICKNESS)
  """Edge of the platform [m]; it grows by what is left when no whole step fits any more."""

  def build(self, tile: Tile) -> None:
    outer = np.array(tile.inner(self.border))
    n = num_steps(tile.inner(self.border), self.platform, self.step_width)
    tops = np.cumsum(tile.rng.uniform(*self.step_height, size=n)) * tile.scaled(self.scale)
    tile.slab()
    below = 0.0
    for k, top in enumerate(tops):
      # A step too low to be felt is left to the next one.
      if top - below >= FLAT:
        tile.block(tuple(outer - 2.0 * k * self.step_width), (-GROUND_DEPTH, float(top)))
        below = top
