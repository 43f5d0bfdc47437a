"""Slopes, waves, noise and obstacles as height fields."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mjlab_terrain.checked_fields import choice, drawn, number, scaled
from mjlab_terrain.solids import MIN_THICKNESS, Floats
from mjlab_terrain.tile import Tile
from mjlab_terrain.tile_cfg import BorderedTileCfg


@dataclass(kw_only=True)
class PyramidSlopeCfg(BorderedTileCfg):
  """Slopes on all four sides, up to a platform in the middle, or down to it. Harder: steeper."""

  slope: tuple[float, float] = scaled((0.0, 0.7), harder="more")
  """Rise over run of the slopes [1]."""
  curved: bool = False
  """True makes slopes flatten towards the corners of the tile, as the product of a ramp along x and one along y."""
  inverted: bool = False
  """True makes the slopes go down."""
  platform: float = number(2.0, least=MIN_THICKNESS)
  """Edge of the platform [m]."""
  resolution: float = number(0.1, least=0.01)
  """Distance between the vertices of the height field [m]."""

  def build(self, tile: Tile) -> None:
    x, y = tile.grid(self.resolution)
    inner = tile.inner(self.border)
    reach = 0.5 * min(inner)

    def height(x: Floats, y: Floats) -> Floats:
      if not self.curved:
        return np.clip(np.minimum(0.5 * inner[0] - np.abs(x), 0.5 * inner[1] - np.abs(y)), 0.0, reach)
      return reach * np.prod(
        [np.clip(1.0 - 2.0 * np.abs(p) / s, 0.0, 1.0) for p, s in zip((x, y), inner, strict=True)], 0
      )

    edge = np.array(0.5 * self.platform)
    top = height(edge, edge) if self.curved else np.array(reach - edge)
    slope = tile.scaled(self.slope)
    z = np.minimum(height(*np.broadcast_arrays(x, y)), top) * (-slope if self.inverted else slope)
    tile.heights(z)


@dataclass(kw_only=True)
class RandomRoughCfg(BorderedTileCfg):
  """Rough ground of random heights. Harder: rougher."""

  amplitude: tuple[float, float] = scaled((0.0, 0.05), harder="more")
  """Heights differ from the rim by up to this much [m]."""
  step: float | None = number(None, least=0.001)
  """Heights are multiples of it [m]; None draws from all heights."""
  spacing: float = number(0.1, least=0.01)
  """Distance between the points whose heights are drawn [m]; between them the ground is smooth."""
  blend: float = number(0.25)
  """Width over which the heights grow from the rim inwards [m]."""
  resolution: float = number(0.1, least=0.01)
  """Distance between the vertices of the height field [m]."""

  def build(self, tile: Tile) -> None:
    x, y = tile.grid(self.resolution)
    counts = [max(round(s / self.spacing), 1) + 1 for s in tile.size]
    unit = tile.rng.uniform(-1.0, 1.0, counts)
    amplitude = tile.scaled(self.amplitude)
    if self.step is not None:
      # Levels are equally likely, those at both ends too.
      levels = int(amplitude / self.step + 1e-9)
      drawn_heights = np.clip(np.floor((unit + 1.0) * (levels + 0.5)) - levels, -levels, levels) * self.step
    else:
      drawn_heights = unit * amplitude
    weights = [_smooth_weights(len(p.ravel()), n) for p, n in zip((x, y), counts, strict=True)]
    tile.heights(weights[0] @ drawn_heights @ weights[1].T * tile.fade(x, y, self.border, self.blend))
    tile.spawn_on_top()


def _smooth_weights(fine: int, coarse: int) -> Floats:
  """Return weights that interpolate `coarse` points at `fine` points over the same interval, (fine, coarse).

  The interpolation is smooth and does not overshoot.
  """
  at = np.linspace(0.0, coarse - 1.0, fine)
  index = np.minimum(at.astype(np.int64), coarse - 2)
  t = at - index
  t = t * t * (3.0 - 2.0 * t)
  weights = np.zeros((fine, coarse))
  weights[np.arange(fine), index] = 1.0 - t
  weights[np.arange(fine), index + 1] += t
  return weights


@dataclass(kw_only=True)
class WavesCfg(BorderedTileCfg):
  """Waves along x plus waves along y, with a crest in the middle. Harder: higher."""

  amplitude: tuple[float, float] = scaled((0.0, 0.2), harder="more")
  """Height of the highest crest above the rim, and depth of the deepest trough [m]."""
  num_waves: float = number(4.0, least=0.1)
  """Number of waves along the shorter side of the tile."""
  blend: float = number(0.25)
  """Width over which the heights grow from the rim inwards [m]."""
  resolution: float = number(0.1, least=0.01)
  """Distance between the vertices of the height field [m]."""

  def build(self, tile: Tile) -> None:
    x, y = tile.grid(self.resolution)
    k = 2.0 * math.pi * self.num_waves / min(tile.inner(self.border))
    waves = 0.5 * (np.cos(k * x) + np.cos(k * y))
    tile.heights(tile.scaled(self.amplitude) * waves * tile.fade(x, y, self.border, self.blend))
    tile.spawn_on_top()


@dataclass(kw_only=True)
class DiscreteObstaclesCfg(BorderedTileCfg):
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
  resolution: float = number(0.1, least=0.01)
  """Distance between the vertices of the height field [m]."""

  def build(self, tile: Tile) -> None:
    x, y = tile.grid(self.resolution)
    n = self.num_obstacles
    edges = tile.rng.uniform(*self.width, (n, 2))
    if self.square:
      edges[:, 1] = edges[:, 0]
    at = tile.rng.uniform(-0.5, 0.5, (n, 2)) * (np.array(tile.inner(self.border)) - edges)
    factor = np.array([-1.0, -0.5, 0.5, 1.0])[tile.rng.integers(4, size=n)]
    height = tile.scaled(self.height) * (factor if self.mode == "choice" else np.ones(n))
    z = np.zeros((len(x), y.shape[1]))
    for k in range(n):
      inside = [np.abs(p.ravel() - at[k, axis]) <= 0.5 * edges[k, axis] for axis, p in enumerate((x, y))]
      z[np.ix_(*inside)] = height[k]
    # The sides of obstacles start beyond the platform's edge.
    cell = self.resolution
    z[(np.abs(x) <= 0.5 * self.platform + cell) & (np.abs(y) <= 0.5 * self.platform + cell)] = 0.0
    tile.heights(z)


@dataclass(kw_only=True)
class PerlinNoiseCfg(BorderedTileCfg):
  """Hills of fractal Perlin noise. Harder: higher."""

  height: tuple[float, float] = scaled((0.0, 1.0), harder="more")
  """Difference between the highest and the lowest point inside the border [m]."""
  wavelength: float = number(1.6, least=0.1)
  """Size of the largest features [m]."""
  octaves: int = number(4, least=1, most=12)
  """Number of noises that are added; those with features smaller than a cell are left out."""
  persistence: float = number(0.3, most=1.0)
  """Amplitude of each noise relative to that before it."""
  lacunarity: float = number(2.0, least=1.0)
  """Frequency of each noise relative to that before it."""
  blend: float = number(0.5)
  """Width over which the heights grow from the rim inwards [m]."""
  resolution: float = number(0.1, least=0.01)
  """Distance between the vertices of the height field [m]."""

  def build(self, tile: Tile) -> None:
    x, y = tile.grid(self.resolution)
    noise = np.zeros((len(x), y.shape[1]))
    for octave in range(self.octaves):
      frequency = self.lacunarity**octave / self.wavelength
      if octave and frequency * self.resolution > 1.0 + 1e-9:
        break
      noise += self.persistence**octave * perlin(x.ravel() * frequency, y.ravel() * frequency, tile.rng)
    noise = (noise - noise.min()) / max(np.ptp(noise), 1e-12)
    tile.heights(tile.scaled(self.height) * noise * tile.fade(x, y, self.border, self.blend))
    tile.spawn_on_top()


def perlin(x: Floats, y: Floats, rng: np.random.Generator) -> Floats:
  """Return gradient noise with features of size 1 at the points of a grid, (nx, ny).

  Source: Perlin, "Improving noise", 2002.
  """
  (i, u), (j, v) = [(np.floor(p - p[0]).astype(np.int64), (p - p[0]) % 1.0) for p in (x, y)]
  angle = rng.uniform(0.0, 2.0 * np.pi, (i[-1] + 2, j[-1] + 2))
  gradient = np.stack((np.cos(angle), np.sin(angle)), -1)
  u, v = u[:, None], v[None, :]

  def corner(di: int, dj: int) -> Floats:
    g = gradient[i[:, None] + di, j[None, :] + dj]
    return g[..., 0] * (u - di) + g[..., 1] * (v - dj)

  s, t = (f**3 * (f * (6.0 * f - 15.0) + 10.0) for f in (u, v))
  near = corner(0, 0) + s * (corner(1, 0) - corner(0, 0))
  far = corner(0, 1) + s * (corner(1, 1) - corner(0, 1))
  return near + t * (far - near)
