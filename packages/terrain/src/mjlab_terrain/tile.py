"""Geometry of one tile, and the tools to build it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mjlab_terrain.solids import FLAT, GROUND_DEPTH, MIN_THICKNESS, Floats, HeightField, Interval, Solid, box_between
from mjlab_terrain.surface import lowest_points, num_steps, over_disc, surface


@dataclass(eq=False)
class Tile:
  """Tile of a terrain.

  Its frame has its origin at the tile's centre, at the height of the rim where tiles meet, and the axes of the world.
  """

  size: tuple[float, float]
  """Extent along x and y [m]."""
  difficulty: float
  """From 0, easiest, to 1, hardest."""
  rng: np.random.Generator
  """Source of all randomness. Draw the same numbers at any difficulty and scale them: then features grow with it."""
  place: tuple[int, int] = (0, 0)
  """Row and column in its grid."""
  kind: int = 0
  """Index of its type in its grid."""
  center: Floats = field(default_factory=lambda: np.zeros(3))
  """Origin of its frame, world frame, (3,) [m]."""
  spawn: tuple[float, float] = (0.0, 0.0)
  """Spawn point [m]; its height is that of the surface."""
  solids: list[Solid] = field(default_factory=list)
  """Ground of the tile, in its frame."""

  @property
  def origin(self) -> Floats:
    """Spawn point on the surface, world frame, (3,) [m]."""
    height = surface(self.solids, *np.reshape(self.spawn, (2, 1)))
    return self.center + np.append(self.spawn, height)

  @cached_property
  def lowest_points(self) -> tuple[float, float]:
    """Lowest height of the surface of the finished tile, and the lowest along its rim [m]."""
    return lowest_points(self.solids, self.size)

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
    self.solids.append(replace(solid, kind=self.kind))

  def box(
    self, x: Interval, y: Interval, z: Interval, *, slope: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0
  ) -> None:
    """Add a box between these bounds [m].

    Args:
      x: Lowest and highest x.
      y: Lowest and highest y.
      z: Bottom, and height of the middle of the top.
      slope: Rise of the top along x and y [1].
      yaw: Angle of the box about the vertical through its middle [rad].
    """
    self.add(box_between(x, y, z, slope=slope, yaw=yaw))

  def block(self, border: float, z: Interval) -> None:
    """Add a box over the whole tile except a border of this width [m]."""
    x, y = np.multiply(0.5, self.inner(border)).tolist()
    self.box((-x, x), (-y, y), z)

  def slab(self, top: float = 0.0) -> None:
    """Add level ground over the whole tile, its top at this height [m]."""
    self.block(0.0, (top - GROUND_DEPTH, top))

  def ring(self, outer: float, inner: float, z: Interval, arms: float | None = None) -> None:
    """Add four boxes around the middle, between a border of width `outer` and one of width `inner` [m].

    With `arms` each box is only the middle of its side, of that width [m].
    """
    if inner - outer < 1e-9:
      return
    ox, oy, ix, iy = np.multiply(0.5, (*self.inner(outer), *self.inner(inner))).tolist()
    wide, narrow = (oy, ix) if arms is None else (0.5 * arms, 0.5 * arms)
    self.box((-ox, -ix), (-wide, wide), z)
    self.box((ix, ox), (-wide, wide), z)
    self.box((-narrow, narrow), (-oy, -iy), z)
    self.box((-narrow, narrow), (iy, oy), z)

  def pit(self, depth: float, border: float) -> None:
    """Add a floor `depth` below the rim over the whole tile, and a border at the rim's height around it [m]."""
    self.slab(-depth)
    self.ring(0.0, border, (-depth, 0.0))

  def grid(self, resolution: float) -> tuple[Floats, Floats]:
    """Return vertices of a grid over the tile, about `resolution` apart: x as (nx, 1) and y as (1, ny) [m]."""
    axes = [np.linspace(-0.5 * s, 0.5 * s, max(round(s / resolution), 2) + 1) for s in self.size]
    return axes[0][:, None], axes[1][None, :]

  def fade(self, x: Floats, y: Floats, border: float, blend: float) -> Floats:
    """Return a factor for heights at (x, y): 0 on the border, 1 inside, smooth over the `blend` [m] between them."""
    to_rim = np.minimum(0.5 * self.size[0] - np.abs(x), 0.5 * self.size[1] - np.abs(y))
    t = np.clip((to_rim - border) / max(blend, 1e-9), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)

  def heights(self, heights: Floats) -> None:
    """Add a surface over the whole tile, and spawn on top of it.

    Args:
      heights: Heights at the vertices of a regular grid, first index along x, (nx, ny) [m].
    """
    if np.ptp(heights) < FLAT:
      self.slab(float(heights.max()))
      return
    half = 0.5 * self.size[0], 0.5 * self.size[1]
    bottom = float(heights.min()) - GROUND_DEPTH
    self.add(HeightField(center=np.zeros(3), half=half, bottom=bottom, heights=heights))
    self.spawn_on_top()

  def spawn_on_top(self, search: float = 1.0, radius: float = 0.4) -> None:
    """Set the spawn point to the nearest place above which nothing within `radius` [m] rises.

    The search ends `search` [m] from the centre along x and y. If there is no such place, take the best one.
    """
    spacing = 0.05
    around = num_steps(radius, spacing)
    counts = [around + int(min(search, 0.5 * extent) / spacing) for extent in self.size]
    axes = [spacing * np.arange(-count, count + 1, dtype=np.float64) for count in counts]
    z = surface(self.solids, *axes)
    inside = slice(around, -around)
    rise = over_disc(z, radius, spacing, np.maximum) - z[inside, inside]
    x, y = np.meshgrid(*(axis[inside] for axis in axes), indexing="ij")
    best = np.lexsort((np.hypot(x, y).ravel(), np.round(rise, 3).ravel()))[0]
    self.spawn = float(x.flat[best]), float(y.flat[best])
