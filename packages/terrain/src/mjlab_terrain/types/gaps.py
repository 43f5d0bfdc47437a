"""Footholds over a pit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjlab_terrain.checked_fields import number, scaled
from mjlab_terrain.solids import FLAT, MIN_THICKNESS
from mjlab_terrain.tile import Tile
from mjlab_terrain.tile_cfg import BorderedTileCfg


@dataclass(kw_only=True)
class _PitCfg(BorderedTileCfg):
  """Footholds over a pit."""

  pit_depth: float = number(2.0, least=0.5)
  """Depth of the pit below the rim [m]."""


@dataclass(kw_only=True)
class SteppingStonesCfg(_PitCfg):
  """Stones on a lattice over a pit, around a platform. Harder: smaller, farther apart and more irregular stones."""

  stone_size: tuple[float, float] = scaled((0.8, 0.4), harder="less", least=0.1)
  """Edge of a stone [m]."""
  stone_distance: float = number(0.2)
  """Least gap between the largest stones [m]. The lattice stays the same, so gaps grow as stones shrink."""
  height_variation: tuple[float, float] = scaled((0.0, 0.1), harder="more")
  """Largest height of a stone above or below the rim [m]."""
  size_variation: tuple[float, float] = scaled((0.0, 0.1), harder="more")
  """Largest change of the length of an edge [m]."""
  displacement: tuple[float, float] = scaled((0.0, 0.1), harder="more")
  """Largest distance of a stone from its place on the lattice, along x and along y [m]."""
  platform: float = number(1.0, least=MIN_THICKNESS)
  """Least edge of the platform [m]; it grows towards the nearest whole stones."""

  def build(self, tile: Tile) -> None:
    side = tile.scaled(self.stone_size)
    inner = 0.5 * np.array(tile.inner(self.border))
    lattices, platform = [], []
    for reach in inner:
      count = max(int(2.0 * reach / (self.stone_size[0] + self.stone_distance) + 1e-9) + 1, 2)
      places = np.linspace(-reach, reach, count)
      # The platform ends one gap before the first stone that stays whole.
      ends = places - 0.5 * side - max(places[1] - places[0] - side, 0.0)
      lattices.append(places)
      platform.append(float(min(ends[ends >= 0.5 * self.platform - 1e-9], default=0.5 * self.platform)))
    tile.pit(self.pit_depth, self.border)
    x, y = platform
    tile.box((-x, x), (-y, y), (-self.pit_depth, 0.0))
    center = np.stack(np.meshgrid(*lattices, indexing="ij"), -1)
    center = center + tile.rng.uniform(-1.0, 1.0, center.shape) * tile.scaled(self.displacement)
    half = 0.5 * (side + tile.rng.uniform(-1.0, 1.0, center.shape) * tile.scaled(self.size_variation))
    tops = tile.rng.uniform(-1.0, 1.0, center.shape[:2]) * tile.scaled(self.height_variation)
    low, high = np.maximum(center - half, -inner), np.minimum(center + half, inner)
    under = (np.abs(center) < platform).all(-1)
    stones = np.stack((low, high), axis=-1)
    for i, j in np.argwhere(~under & (high - low >= MIN_THICKNESS).all(-1)):
      x, y = stones[i, j].tolist()
      tile.box(x, y, (-self.pit_depth, float(tops[i, j])))


@dataclass(kw_only=True)
class NarrowBeamsCfg(_PitCfg):
  """Beams from a platform to the rim over a pit, like the spokes of a wheel. Harder: narrower beams.

  Their tops are 1 mm below platform and rim, so that a foot touches only one of the two where they meet.
  """

  num_beams: int = number(12, least=1)
  """Number of beams, at equal angles."""
  beam_width: tuple[float, float] = scaled((0.8, 0.2), harder="less", least=MIN_THICKNESS)
  """Width of a beam [m]."""
  platform: float = number(1.0, least=0.2)
  """Least edge of the platform [m]; it grows until beams are apart where they leave it."""

  def check(self, name: str, size: tuple[float, float]) -> None:
    super().check(name, size)
    # Difficulty has no effect if even the narrowest beams touch each other all the way.
    room, half = 0.5 * min(size) - self.border - MIN_THICKNESS, 0.5 * self.beam_width[1]
    most = int(math.pi / math.asin(half / room)) if half < room else 2
    if self.num_beams > max(most, 2):
      self.refuse(name, f"num_beams {self.num_beams} leaves no gaps between beams; at most {most} would work")

  def build(self, tile: Tile) -> None:
    half = 0.5 * tile.scaled(self.beam_width)
    inner, outer = 0.5 * np.array(tile.inner(self.border)), 0.5 * np.array(tile.size)
    # Neighbouring beams part at this distance from the centre; a beam is no wider than the platform.
    apart = half / math.sin(math.pi / max(self.num_beams, 2))
    platform = max(0.5 * self.platform, apart)
    if platform > inner.min() - MIN_THICKNESS:
      tile.slab()
      return
    tile.pit(self.pit_depth, self.border)
    square = -platform, platform
    tile.box(square, square, (-self.pit_depth, 0.0))
    # Both corners of the near end lie on the platform.
    start = math.sqrt(platform**2 - half**2)
    for k in range(self.num_beams):
      angle = 2.0 * math.pi * k / self.num_beams
      along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
      along[np.abs(along) < 1e-12] = 1e-12
      corners = np.array([[-half], [half]]) * across
      # Both corners of the far end reach the rim, and none leaves the tile.
      reach = ((np.sign(along) * inner - corners) / along).min(-1).max()
      inside = ((np.sign(along) * outer - corners) / along).min()
      end = min(reach, inside)
      x, y = 0.5 * (start + end) * along
      length = 0.5 * (end - start)
      tile.box((x - length, x + length), (y - half, y + half), (-self.pit_depth, -FLAT), yaw=angle)


@dataclass(kw_only=True)
class NestedRingsCfg(_PitCfg):
  """Square rings over a pit, around a platform. Harder: narrower rings and wider gaps."""

  num_rings: int = number(8, least=1)
  """Greatest number of rings; fewer if the tile has too little room at some difficulty."""
  ring_width: tuple[float, float] = scaled((0.6, 0.3), harder="less", least=MIN_THICKNESS)
  """Width of a ring [m]."""
  gap: tuple[float, float] = scaled((0.1, 0.4), harder="more")
  """Width of the gaps [m]."""
  platform: float = number(1.0, least=MIN_THICKNESS)
  """Least edge of the platform, which fills the space inside the rings [m]."""

  def check(self, name: str, size: tuple[float, float]) -> None:
    super().check(name, size)
    # Room that is missing for one ring and two gaps, at either end of the difficulty.
    short = max(width + 2.0 * gap for width, gap in zip(self.ring_width, self.gap, strict=True)) - self._room(size)
    if short > 1e-9:
      self.refuse(
        name, f"no ring fits between border and platform; make the tile at least {min(size) + 2.0 * short:g} m"
      )

  def _room(self, size: tuple[float, float]) -> float:
    return 0.5 * (min(size) - self.platform) - self.border

  def build(self, tile: Tile) -> None:
    width, gap = tile.scaled(self.ring_width), tile.scaled(self.gap)
    if gap < FLAT:
      tile.slab()
      return
    tile.pit(self.pit_depth, self.border)
    # As many rings at any difficulty.
    ends = zip(self.ring_width, self.gap, strict=True)
    fits = min(int((self._room(tile.size) - g) / (w + g) + 1e-9) for w, g in ends)
    border = self.border + gap
    for _ in range(min(self.num_rings, fits)):
      tile.ring(border, border + width, (-self.pit_depth, 0.0))
      border += width + gap
    tile.block(border, (-self.pit_depth, 0.0))
