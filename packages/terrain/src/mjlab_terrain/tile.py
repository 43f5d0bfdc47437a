"""Geometry of one tile, and the tools that a type builds it with."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjlab_terrain.solids import FLAT, GROUND_DEPTH, MIN_THICKNESS, Box, HeightField, Interval, Prism, Solid
from mjlab_terrain.surface import disc, over_disc, surface


class Tile:
  """Tile that is being built.

  Its frame has its origin at the tile's centre, at the height of the rim where tiles meet, and the axes of the world.
  """

  def __init__(self, size: tuple[float, float], difficulty: float, rng: np.random.Generator) -> None:
    self.size = size
    """Extent along x and y [m]."""
    self.difficulty = difficulty
    """From 0, easiest, to 1, hardest."""
    self.rng = rng
    """Source of all randomness. Draw the same numbers at any difficulty, and scale them: then features grow with it."""
    self.spawn: tuple[float, float] = (0.0, 0.0)
    """Spawn point [m]; its height is that of the surface."""
    self.solids: list[Solid] = []

  def scaled(self, ends: Interval) -> float:
    """Return the value at this tile's difficulty, between that of the easiest and that of the hardest."""
    easiest, hardest = ends
    return easiest + self.difficulty * (hardest - easiest)

  def inner(self, border: float) -> tuple[float, float]:
    """Return the extent inside a border of this width, along x and y [m]."""
    return self.size[0] - 2.0 * border, self.size[1] - 2.0 * border

  def add(self, solid: Solid) -> None:
    """Add a solid.

    Raises:
      ValueError: a part of it is thinner than 5 cm, or not finite.
    """
    # Comparisons with NaN are false.
    if not MIN_THICKNESS - 1e-9 <= solid.thickness < np.inf or not np.isfinite(solid.low + solid.high).all():
      size = " x ".join(f"{extent:.3g}" for extent in solid.high - solid.low)
      raise ValueError(
        f"a {type(solid).__name__} of {size} m, {solid.thickness:.3g} m thick, is not finite "
        f"or thinner than {MIN_THICKNESS} m."
      )
    self.solids.append(solid)

  def box(self, x: Interval, y: Interval, z: Interval) -> None:
    """Add a box between these bounds [m]."""
    low, high = np.array([x, y, z], dtype=np.float64).T
    self.add(Box(center=0.5 * (low + high), half=0.5 * (high - low)))

  def turned_box(self, center: ArrayLike, half: ArrayLike, rotation: NDArray[np.float64] | None) -> None:
    """Add a box by its centre, half extents [m] and axes, the columns of `rotation`."""
    floats = np.array((center, half), dtype=np.float64)
    self.add(Box(center=floats[0], half=floats[1], rotation=rotation))

  def prism(self, x: Interval, y: Interval, bottom: float, top: float, slope: tuple[float, float]) -> None:
    """Add an upright prism over a rectangle: a plane from `slope` [1] through the height `top` at its middle [m]."""
    center = np.array((0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1]), top))
    self.add(Prism(center=center, half=(0.5 * (x[1] - x[0]), 0.5 * (y[1] - y[0])), slope=slope, bottom=bottom))

  def slab(self, top: float = 0.0) -> None:
    """Add level ground over the whole tile, its top at this height [m]."""
    x, y = 0.5 * self.size[0], 0.5 * self.size[1]
    self.box((-x, x), (-y, y), (top - GROUND_DEPTH, top))

  def block(self, extent: tuple[float, float], z: Interval) -> None:
    """Add a box of this extent along x and y at the centre [m]."""
    self.box((-0.5 * extent[0], 0.5 * extent[0]), (-0.5 * extent[1], 0.5 * extent[1]), z)

  def frame(
    self, outer: tuple[float, float], inner: tuple[float, float], z: Interval, arms: float | None = None
  ) -> None:
    """Add four boxes around the centre: the space inside `outer` but not inside `inner`, extents along x and y [m].

    With `arms` it is only the middle of each side, of that width [m].
    """
    (ox, oy), (ix, iy) = np.multiply(outer, 0.5), np.multiply(inner, 0.5)
    if ox - ix < 1e-9:
      return
    wide, narrow = (oy, ix) if arms is None else (0.5 * arms, 0.5 * arms)
    self.box((-ox, -ix), (-wide, wide), z)
    self.box((ix, ox), (-wide, wide), z)
    self.box((-narrow, narrow), (-oy, -iy), z)
    self.box((-narrow, narrow), (iy, oy), z)

  def pit(self, depth: float, border: float) -> None:
    """Add a floor `depth` below the rim over the whole tile, and a border at the rim's height around it [m]."""
    self.slab(-depth)
    self.frame(self.size, self.inner(border), (-depth, 0.0))

  def grid(self, resolution: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return vertices of a grid over the tile, about `resolution` apart: x as (nx, 1) and y as (1, ny) [m]."""
    axes = [np.linspace(-0.5 * s, 0.5 * s, max(round(s / resolution), 2) + 1) for s in self.size]
    return axes[0][:, None], axes[1][None, :]

  def fade(self, x: NDArray[np.float64], y: NDArray[np.float64], border: float, blend: float) -> NDArray[np.float64]:
    """Return a factor for heights at (x, y): 0 on the border, 1 inside, smooth over the `blend` [m] between them."""
    to_rim = np.minimum(0.5 * self.size[0] - np.abs(x), 0.5 * self.size[1] - np.abs(y))
    t = np.clip((to_rim - border) / max(blend, 1e-9), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)

  def heights(self, heights: NDArray[np.float64]) -> None:
    """Add a surface over the whole tile: heights at the vertices of a regular grid, (nx, ny) [m], x first."""
    if np.ptp(heights) < FLAT:
      self.slab(float(heights.max()))
      return
    x, y = 0.5 * self.size[0], 0.5 * self.size[1]
    bottom = float(heights.min()) - GROUND_DEPTH
    self.add(HeightField(heights=heights, x=(-x, x), y=(-y, y), bottom=bottom))

  def spawn_height(self) -> float:
    """Return the height of the surface at `spawn` [m]."""
    x, y = (np.array([c]) for c in self.spawn)
    return float(surface(self.solids, x, y)[0, 0])

  def spawn_on_top(self, search: float = 1.0, radius: float = 0.4) -> None:
    """Set the spawn point to the nearest place above which nothing within `radius` [m] rises.

    The search ends `search` [m] from the centre along x and y; without such a place, the best one is taken.
    """
    spacing = 0.05
    axes: list[NDArray[np.float64]] = []
    for extent in self.size:
      count = int(min(search + radius, 0.5 * extent) / spacing)
      axes.append(spacing * np.arange(-count, count + 1, dtype=np.float64))
    z = surface(self.solids, *axes)
    rise = over_disc(z, disc(radius, spacing), np.maximum) - z
    x, y = np.meshgrid(*axes, indexing="ij")
    rise[(np.abs(x) > search) | (np.abs(y) > search)] = np.inf
    best = np.lexsort((np.hypot(x, y).ravel(), np.round(rise, 3).ravel()))[0]
    self.spawn = float(x.flat[best]), float(y.flat[best])
