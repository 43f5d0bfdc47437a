"""Stairs around the middle of a tile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjlab_terrain.checked_fields import drawn, number, scaled
from mjlab_terrain.solids import FLAT, GROUND_DEPTH, MIN_THICKNESS
from mjlab_terrain.tile import Tile
from mjlab_terrain.tile_cfg import BorderedTileCfg


@dataclass(kw_only=True)
class _StairsCfg(BorderedTileCfg):
  """Stairs on all four sides of a platform."""

  platform: float = number(1.0, least=MIN_THICKNESS)
  """Least edge of the platform [m]; it grows by the space that is too narrow for a step."""

  def num_steps(self, tile: Tile, width: float) -> int:
    """Return the number of steps of this width that fit on each side of the platform."""
    return max(int((min(tile.inner(self.border)) - self.platform) / (2.0 * width) + 1e-9), 0)


@dataclass(kw_only=True)
class PyramidStairsCfg(_StairsCfg):
  """Stairs on all four sides, up to a platform in the middle, or down to it. Harder: higher steps."""

  step_height: tuple[float, float] = scaled((0.0, 0.2), harder="more")
  """Rise of each step [m]."""
  step_width: float = number(0.3, least=MIN_THICKNESS)
  """Depth of each tread [m]."""
  platform: float = number(3.0, least=MIN_THICKNESS)
  """Least edge of the platform [m]; it grows by the space that is too narrow for a step."""
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
    n = self.num_steps(tile, self.step_width)
    up = -rise if self.inverted else rise
    floor = min((n + 1) * up, 0.0) - (self.pit_depth if self.holes else GROUND_DEPTH)
    if self.holes:
      tile.slab(floor)
    tile.ring(0.0, self.border, (floor, 0.0))
    for k in range(n):
      outer, z = self.border + k * self.step_width, (floor, (k + 1) * up)
      if self.inverted or self.holes:
        tile.ring(outer, outer + self.step_width, z, arms=self.platform if self.holes else None)
      else:
        # Going up, each level lies on the one below: one box instead of four.
        tile.block(outer, z)
    top = floor, (n + 1) * up
    if self.holes:
      x = -0.5 * self.platform, 0.5 * self.platform
      tile.box(x, x, top)
    else:
      tile.block(self.border + n * self.step_width, top)


@dataclass(kw_only=True)
class OpenStairsCfg(_StairsCfg):
  """Stairs of thin treads with open risers, on all four sides. Harder: higher and narrower steps.

  An open riser is a slot one tread deep; its floor is level with the tread in front of it. A foot can slip under a
  tread, but it cannot fall.
  """

  step_height: tuple[float, float] = scaled((0.0, 0.2), harder="more")
  """Rise of each step [m]."""
  step_width: tuple[float, float] = scaled((0.8, 0.4), harder="less", least=MIN_THICKNESS)
  """Depth of each tread [m]."""
  step_thickness: float = number(MIN_THICKNESS, least=MIN_THICKNESS)
  """Thickness of each tread [m]."""
  inverted: bool = False
  """True makes the stairs go down."""

  def build(self, tile: Tile) -> None:
    rise, width = tile.scaled(self.step_height), tile.scaled(self.step_width)
    n = self.num_steps(tile, width)
    if rise < FLAT or n == 0:
      tile.slab()
      return
    # Each tread lies one rise above solid stairs.
    floor = -n * rise if self.inverted else 0.0
    tile.slab(floor)
    if self.inverted:
      tile.ring(0.0, self.border, (floor - GROUND_DEPTH, 0.0))
    for k in range(n):
      outer, inner = self.border + k * width, self.border + (k + 1) * width
      top = -k * rise if self.inverted else (k + 1) * rise
      tile.ring(outer, inner, (top - self.step_thickness, top))
      if not self.inverted and k > 0:
        tile.block(outer, (-GROUND_DEPTH, k * rise))
      elif self.inverted and k < n - 1:
        tile.ring(outer, inner, (floor - GROUND_DEPTH, top - rise))
    if not self.inverted:
      border, top = self.border + n * width, (n + 1) * rise
      tile.block(border, (-GROUND_DEPTH, n * rise))
      tile.block(border, (top - self.step_thickness, top))


@dataclass(kw_only=True)
class RandomStairsCfg(_StairsCfg):
  """Stairs up to a platform with steps of random height. Harder: higher steps."""

  step_height: tuple[float, float] = drawn((0.1, 0.3))
  """Rise of each step [m], before it is scaled."""
  scale: tuple[float, float] = scaled((0.0, 1.0), harder="more")
  """Factor on the rise of all steps."""
  step_width: float = number(0.8, least=MIN_THICKNESS)
  """Depth of each tread [m]."""

  def build(self, tile: Tile) -> None:
    n = self.num_steps(tile, self.step_width)
    tops = np.cumsum(tile.rng.uniform(*self.step_height, size=n)) * tile.scaled(self.scale)
    tile.slab()
    below = 0.0
    for k, top in enumerate(tops.tolist()):
      # A step that is too low becomes part of the next one.
      if top - below >= FLAT:
        tile.block(self.border + k * self.step_width, (-GROUND_DEPTH, top))
        below = top
