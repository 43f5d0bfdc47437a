"""Slopes, waves, noise and obstacles as height fields."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mjlab_terrain.checked_fields import choice, drawn, number, scaled
from mjlab_terrain.solids import MIN_THICKNESS, Floats
from mjlab_terrain.tile import Tile
from mjlab_terrain.tile_cfg import BorderedTileCfg


@dataclass(kw_only=True)
class _HeightsCfg(BorderedTileCfg):
  """Height field over the whole tile."""

  resolution: float = number(0.1, least=0.01)
  """Distance between the vertices of the height field [m]."""

  def build(self, tile: Tile) -> None:
    tile.heights(self.heights(tile, *tile.grid(self.resolution)))

  @abstractmethod
  def heights(self, tile: Tile, x: Floats, y: Floats) -> Floats:
    """Return the heights at the grid of points `x` (nx, 1) and `y` (1, ny), (nx, ny) [m]."""


@dataclass(kw_only=True)
class PyramidSlopeCfg(_HeightsCfg):
  """Slopes on all four sides, up to a platform in the middle, or down to it. Harder: steeper."""

  slope: tuple[float, float] = scaled((0.0, 0.7), harder="more")
  """Rise over run of the slopes [1]."""
  curved: bool = False
  """True makes slopes flatten towards the corners of the tile, as the product of a ramp along x and one along y."""
  inverted: bool = False
  """True makes the slopes go down."""
  platform: float = number(2.0, least=MIN_THICKNESS)
  """Edge of the platform [m]."""

  def heights(self, tile: Tile, x: Floats, y: Floats) -> Floats:
    reach = 0.5 * np.array(tile.inner(self.border))

    def height(x: Floats, y: Floats) -> Floats:
      to_rim_x, to_rim_y = (np.maximum(r - np.abs(p), 0.0) for r, p in zip(reach, (x, y), strict=True))
      return to_rim_x * to_rim_y / reach.max() if self.curved else np.minimum(to_rim_x, to_rim_y)

    edge = np.array(0.5 * self.platform)
    slope = tile.scaled(self.slope)
    return np.minimum(height(x, y), height(edge, edge)) * (-slope if self.inverted else slope)


@dataclass(kw_only=True)
class RandomRoughCfg(_HeightsCfg):
  """Rough ground of random heights. Harder: rougher."""

  amplitude: tuple[float, float] = scaled((0.0, 0.05), harder="more")
  """Heights differ from the rim by up to this much [m]."""
  step: float | None = number(None, least=0.001)
  """Heights are multiples of this step [m]; None allows all heights."""
  spacing: float = number(0.1, least=0.01)
  """Distance between points of random height [m]; between them the ground is smooth."""
  blend: float = number(0.25)
  """Width over which the heights grow from the rim inwards [m]."""

  def heights(self, tile: Tile, x: Floats, y: Floats) -> Floats:
    counts = [max(round(s / self.spacing), 1) + 1 for s in tile.size]
    unit = tile.rng.uniform(-1.0, 1.0, counts)
    amplitude = tile.scaled(self.amplitude)
    if self.step is not None:
      # Levels are equally likely, those at both ends too.
      levels = int(amplitude / self.step + 1e-9)
      coarse = np.clip(np.floor((unit + 1.0) * (levels + 0.5)) - levels, -levels, levels) * self.step
    else:
      coarse = unit * amplitude
    smooth = _interpolated(_interpolated(coarse, x.size).T, y.size).T
    return smooth * tile.fade(x, y, self.border, self.blend)


def _interpolated(coarse: Floats, num: int) -> Floats:
  """Return `num` rows over the same interval as the given ones, (num, columns).

  The interpolation is smooth and does not overshoot.
  """
  at = np.linspace(0.0, len(coarse) - 1.0, num)
  index = np.minimum(at.astype(np.int64), len(coarse) - 2)
  t = (at - index)[:, None]
  return coarse[index] + t * t * (3.0 - 2.0 * t) * (coarse[index + 1] - coarse[index])


@dataclass(kw_only=True)
class WavesCfg(_HeightsCfg):
  """Waves along x plus waves along y, with a crest in the middle. Harder: higher."""

  amplitude: tuple[float, float] = scaled((0.0, 0.2), harder="more")
  """Height of the highest crest above the rim, and depth of the deepest trough [m]."""
  num_waves: float = number(4.0, least=0.1)
  """Number of waves along the shorter side of the tile."""
  blend: float = number(0.25)
  """Width over which the heights grow from the rim inwards [m]."""

  def heights(self, tile: Tile, x: Floats, y: Floats) -> Floats:
    k = 2.0 * math.pi * self.num_waves / min(tile.inner(self.border))
    waves = 0.5 * (np.cos(k * x) + np.cos(k * y))
    return tile.scaled(self.amplitude) * waves * tile.fade(x, y, self.border, self.blend)


@dataclass(kw_only=True)
class DiscreteObstaclesCfg(_HeightsCfg):
  """Rectangular obstacles and hollows around a level platform, later ones over earlier ones. Harder: higher and deeper.

  Their sides are as steep as one cell of the height field allows; for vertical ones see `RandomBoxesCfg`.
  """

  height: tuple[float, float] = scaled((0.0, 0.3), harder="more")
  """Height of the highest obstacles [m]."""
  mode: Literal["choice", "fixed"] = choice("choice", "fixed")
  """With "choice" heights are the full height or half of it, up or down; with "fixed" all are the full height up."""
  width: tuple[float, float] = drawn((0.3, 1.0), least=MIN_THICKNESS, inside=True)
  """Edges of an obstacle [m]."""
  square: bool = False
  """True makes both edges of an obstacle equal."""
  num_obstacles: int = number(40)
  """Number of obstacles, at any difficulty."""
  platform: float = number(1.0)
  """Edge of the level square in the middle [m]."""

  def heights(self, tile: Tile, x: Floats, y: Floats) -> Floats:
    n = self.num_obstacles
    edges = tile.rng.uniform(*self.width, (n, 2))
    if self.square:
      edges[:, 1] = edges[:, 0]
    at = tile.rng.uniform(-0.5, 0.5, (n, 2)) * (np.array(tile.inner(self.border)) - edges)
    factor = np.array([-1.0, -0.5, 0.5, 1.0])[tile.rng.integers(4, size=n)]
    height = tile.scaled(self.height) * (factor if self.mode == "choice" else np.ones(n))
    z = np.zeros_like(x + y)
    for k in range(n):
      half = 0.5 * edges[k]
      z[(np.abs(x - at[k, 0]) <= half[0]) & (np.abs(y - at[k, 1]) <= half[1])] = height[k]
    # The sides of obstacles start beyond the platform's edge.
    free = 0.5 * self.platform + self.resolution
    z[(np.abs(x) <= free) & (np.abs(y) <= free)] = 0.0
    return z


@dataclass(kw_only=True)
class PerlinNoiseCfg(_HeightsCfg):
  """Hills of fractal Perlin noise. Harder: higher."""

  height: tuple[float, float] = scaled((0.0, 1.0), harder="more")
  """Difference between the highest and the lowest point inside the border [m]."""
  wavelength: float = number(1.6, least=0.1)
  """Size of the largest features [m]."""
  octaves: int = number(4, least=1, most=12)
  """Number of noises in the sum; noises with features smaller than a cell are left out."""
  persistence: float = number(0.3, most=1.0)
  """Amplitude of each noise relative to the one before."""
  lacunarity: float = number(2.0, least=1.0)
  """Frequency of each noise relative to the one before."""
  blend: float = number(0.5)
  """Width over which the heights grow from the rim inwards [m]."""

  def heights(self, tile: Tile, x: Floats, y: Floats) -> Floats:
    noise = np.zeros_like(x + y)
    for octave in range(self.octaves):
      frequency = self.lacunarity**octave / self.wavelength
      if octave and frequency * self.resolution > 1.0 + 1e-9:
        break
      noise += self.persistence**octave * perlin(x.ravel() * frequency, y.ravel() * frequency, tile.rng)
    noise = (noise - noise.min()) / max(np.ptp(noise), 1e-12)
    return tile.scaled(self.height) * noise * tile.fade(x, y, self.border, self.blend)


def perlin(x: Floats, y: Floats, rng: np.random.Generator) -> Floats:
  """Return gradient noise with features of size 1 at the points of a grid, (nx, ny).

  Source: Perlin, "Improving noise", 2002.
  """
  (i, u), (j, v) = [(np.floor(p - p[0]).astype(np.int64), (p - p[0]) % 1.0) for p in (x, y)]
  angle = rng.uniform(0.0, 2.0 * np.pi, (i[-1] + 2, j[-1] + 2))
  i, u = i[:, None], u[:, None]
  # Weights of the far corner of a cell, along x and y.
  s, t = (f**3 * (f * (6.0 * f - 15.0) + 10.0) for f in (u, v))
  noise = np.zeros_like(u + v)
  for di, dj in np.ndindex(2, 2):
    corner = angle[i + di, j + dj]
    slope = np.cos(corner) * (u - di) + np.sin(corner) * (v - dj)
    noise += (s if di else 1.0 - s) * (t if dj else 1.0 - t) * slope
  return noise
