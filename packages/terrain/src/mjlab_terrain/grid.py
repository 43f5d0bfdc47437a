"""Terrain of many tiles."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.assembly import PlacedTile, Surface, add_geoms, gather, geom_name
from mjlab_terrain.colors import height_color, type_color
from mjlab_terrain.patches import FlatPatchCfg
from mjlab_terrain.presets import walking_types
from mjlab_terrain.terrain import Terrain, apportion
from mjlab_terrain.tile import GROUND_DEPTH, MIN_THICKNESS, Box, Tile
from mjlab_terrain.tile_cfg import TileCfg

Layout = Literal["curriculum", "random"]
GroundColor = Literal["height", "type"] | tuple[float, float, float]

# What a seed is used for besides tiles, whose key is their row and column.
_LAYOUT, _PATCHES = 0, 1


@dataclass(kw_only=True)
class TerrainGridCfg:
  """Tiles in a grid around the world's origin: rows run along x, columns along y.

  The ground is a function of the settings alone: the same seed gives the same ground, and a tile does not depend on the
  others.
  """

  name: str = "terrain"
  """Name of the body; geoms and their assets are called "<name>_<number>"."""

  types: dict[str, TileCfg] = field(default_factory=walking_types)
  """Types of tile by name. One with share 0 is left out."""

  tile_size: tuple[float, float] = (8.0, 8.0)
  """Extent of a tile along x and y [m]."""

  rows: int = 10
  """Number of tiles along x."""

  columns: int | None = None
  """Number of tiles along y. None is one for each type in a curriculum, as many as rows in a random layout."""

  layout: Layout = "curriculum"
  """In a curriculum, rows go from easy to hard and each type has columns by its share; or all is drawn at random."""

  difficulty: tuple[float, float] = (0.0, 1.0)
  """Difficulty of the easiest and the hardest tiles, in [0, 1]."""

  seed: int = 0
  """Seed of all randomness."""

  border_width: float = 10.0
  """Width of the level ground around the grid [m]."""

  color: GroundColor = "height"
  """What color shows; or one color for all, red, green and blue in [0, 1]."""

  friction: tuple[float, float, float] = (1.0, 0.005, 0.0001)
  """Sliding, torsional and rolling friction [1, m, m]."""

  flat_patches: dict[str, FlatPatchCfg] = field(default_factory=dict)
  """Level places to look for on every tile, by name."""

  light: bool = True
  """Whether a directional light from above comes with it."""

  def add_to(self, spec: mujoco.MjSpec) -> Terrain:
    """Adds a static body with the whole grid to the world of `spec`, in geom group 0.

    Raises:
      ValueError: a setting is out of its range, or `spec` already has an element of a name that is needed; `spec` is as
        it was.
    """
    placed = self.tiles()
    border = self._border(placed)
    boxes, fields = gather(placed, border)
    self._check_names(spec, len(boxes) + len(fields))
    look = Surface(friction=self.friction, coloring=self.coloring())
    geom_names = add_geoms(spec, self.name, boxes, fields, look)
    if self.light:
      spec.body(self.name).add_light(
        name=self.name,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=(0.0, 0.0, 10.0),
        dir=(0.3, 0.2, -1.0),
        diffuse=(0.6, 0.6, 0.6),
        castshadow=True,
      )
    return self._describe(placed, geom_names)

  def tiles(self) -> list[PlacedTile]:
    """All tiles, row by row.

    Raises:
      ValueError: a setting is out of its range; the message says what would work.
    """
    self.check()
    kinds, difficulty = self._plan()
    cfgs = list(self._used().items())
    rows, columns = kinds.shape
    placed = []
    for row, column in np.ndindex(rows, columns):
      name, cfg = cfgs[kinds[row, column]]
      tile = Tile(self.tile_size, float(difficulty[row, column]), self._rng(row, column))
      try:
        cfg.build(tile)
      except ValueError as error:
        raise ValueError(
          f"{type(cfg).__name__} '{name}': at difficulty {tile.difficulty:.3g}, tile ({row}, {column}): {error}"
        ) from error
      if not (tile.boxes or tile.fields):
        raise ValueError(f"{type(cfg).__name__} '{name}': build added no geometry to the tile.")
      place = np.array([row - 0.5 * (rows - 1), column - 0.5 * (columns - 1)]) * self.tile_size
      placed.append(
        PlacedTile(row=row, column=column, kind=int(kinds[row, column]), center=np.array((*place, 0.0)), tile=tile)
      )
    return placed

  def coloring(self) -> Callable[[int, NDArray[np.float64]], NDArray[np.float64]]:
    """Color of ground of a type at heights (...) [m], (..., 3) in [0, 1]."""
    color = self.color
    if color == "height":
      return lambda kind, z: height_color(z)
    if color == "type":
      return type_color
    one = np.array(color, dtype=np.float64)
    return lambda kind, z: np.broadcast_to(one, (*np.shape(z), 3))

  def check(self) -> None:
    """Raises a ValueError if a setting is out of its range, by name and with what would work."""
    who = f"TerrainGridCfg '{self.name}'"
    if not self.name:
      raise ValueError("TerrainGridCfg: name must not be empty.")
    if len(self.tile_size) != 2 or any(not 0.5 <= s < math.inf for s in self.tile_size):
      raise ValueError(f"{who}: tile_size must be two lengths of at least 0.5 m, got {self.tile_size}.")
    for label, count in (("rows", self.rows), ("columns", self.columns), ("seed", self.seed)):
      if count is not None and not isinstance(count, int | np.integer):
        raise ValueError(f"{who}: {label} must be a whole number, got {count!r}.")
    for label, count in (("rows", self.rows), ("columns", self.columns)):
      if count is not None and count < 1:
        raise ValueError(f"{who}: {label} must be at least 1, got {count}.")
    if self.layout not in get_args(Layout):
      raise ValueError(f"{who}: layout {self.layout!r} does not exist; there are 'curriculum' and 'random'.")
    low, high = self.difficulty
    if not 0.0 <= low <= high <= 1.0:
      raise ValueError(f"{who}: difficulty must go up within [0, 1], got {self.difficulty}; (0.0, 1.0) would work.")
    if self.seed < 0:
      raise ValueError(f"{who}: seed must not be negative, got {self.seed}; {-self.seed} would work.")
    if self.border_width != 0.0 and not MIN_THICKNESS <= self.border_width < math.inf:
      raise ValueError(f"{who}: border_width must be 0 or at least {MIN_THICKNESS} m, got {self.border_width}.")
    if any(not 0.0 <= f < math.inf for f in self.friction):
      raise ValueError(f"{who}: friction must not be negative, got {self.friction}.")
    if isinstance(self.color, str):
      good_color = self.color in ("height", "type")
    else:
      good_color = len(self.color) == 3 and all(0.0 <= c <= 1.0 for c in self.color)
    if not good_color:
      raise ValueError(f"{who}: color must be 'height', 'type' or three numbers in [0, 1], got {self.color!r}.")
    if not self.types:
      raise ValueError(f"{who}: types is empty; name at least one, for example {{'flat': FlatCfg()}}.")
    for name, cfg in self.types.items():
      cfg.check(name, self.tile_size)
    used = self._used()
    if not used:
      raise ValueError(f"{who}: the shares of {', '.join(self.types)} sum to 0; give one of them a share of 1.")
    if self.layout == "curriculum" and self.columns is not None and self.columns < len(used):
      raise ValueError(
        f"{who}: {self.columns} columns are too few for the types {', '.join(used)}; at least {len(used)} would work."
      )
    for name, patch in self.flat_patches.items():
      patch.check(name, self.tile_size)

  def _used(self) -> dict[str, TileCfg]:
    return {name: cfg for name, cfg in self.types.items() if cfg.share > 0.0}

  def _shares(self) -> NDArray[np.float64]:
    shares = np.array([cfg.share for cfg in self._used().values()], dtype=np.float64)
    return shares / shares.sum()

  def _columns_of_types(self) -> NDArray[np.int64]:
    """Number of columns of each type in a curriculum, at least one, (types,)."""
    shares = self._shares()
    counts = np.ones(len(shares), dtype=np.int64)
    if self.columns is not None:
      # What a type is owed beyond its first column.
      owed = np.maximum(shares * self.columns - 1.0, 0.0)
      if owed.sum() > 0.0:
        counts += apportion(owed / owed.sum(), self.columns - len(shares))
      else:
        counts[: self.columns - len(shares)] += 1
    return counts

  def _plan(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Type and difficulty of each tile, both (rows, columns)."""
    low, high = self.difficulty
    shares = self._shares()
    if self.layout == "curriculum":
      columns = np.repeat(np.arange(len(shares)), self._columns_of_types())
      row = np.linspace(low, high, self.rows) if self.rows > 1 else np.array([low])
      return np.tile(columns, (self.rows, 1)), np.repeat(row[:, None], len(columns), axis=1)
    rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(_LAYOUT,)))
    shape = self.rows, self.columns or self.rows
    return rng.choice(len(shares), size=shape, p=shares), rng.uniform(low, high, shape)

  def _rng(self, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))

  def _border(self, placed: list[PlacedTile]) -> list[Box]:
    if self.border_width == 0.0:
      return []
    last = placed[-1].center[:2] + 0.5 * np.array(self.tile_size)
    around = Tile(tuple(2.0 * (last + self.border_width)), 0.0, self._rng(_LAYOUT))
    around.frame(around.size, tuple(2.0 * last), (-GROUND_DEPTH, 0.0))
    return around.boxes

  def _check_names(self, spec: mujoco.MjSpec, num_geoms: int) -> None:
    kinds: tuple[tuple[str, Callable[[str], object]], ...] = (
      ("geom", spec.geom),
      ("hfield", spec.hfield),
      ("texture", spec.texture),
      ("material", spec.material),
      ("asset", lambda name: spec.assets.get(f"{name}.png")),
    )
    taken = [("body", self.name)] if spec.body(self.name) is not None else []
    if self.light and spec.light(self.name) is not None:
      taken.append(("light", self.name))
    for kind, find in kinds:
      taken += [(kind, name) for k in range(num_geoms) if find(name := geom_name(self.name, k)) is not None]
    if taken:
      kind, name = taken[0]
      raise ValueError(
        f"TerrainGridCfg '{self.name}': the model '{spec.modelname}' already has a {kind} named '{name}'. "
        "Give the terrain another name, or add it once."
      )

  def _describe(self, placed: list[PlacedTile], geom_names: tuple[str, ...]) -> Terrain:
    kinds, difficulty = self._plan()
    rows, columns = kinds.shape
    shares = self._shares()
    if self.layout == "curriculum":
      column_shares = (shares / self._columns_of_types())[kinds[0]]
    else:
      column_shares = np.full(columns, 1.0 / columns)
    origins = np.zeros((rows, columns, 3))
    patches = {name: np.zeros((rows, columns, cfg.count, 3)) for name, cfg in self.flat_patches.items()}
    lowest, highest = 0.0, 0.0
    for p in placed:
      tile = p.tile
      origins[p.row, p.column] = p.center + np.array((*tile.spawn, tile.spawn_height()))
      for k, (name, cfg) in enumerate(self.flat_patches.items()):
        patches[name][p.row, p.column] = p.center + cfg.find(tile, self._rng(p.row, p.column, _PATCHES, k))
      tops = [box.center[2] + box.extent[2] for box in tile.boxes] + [f.heights.max() for f in tile.fields]
      bottoms = [box.center[2] + box.extent[2] for box in tile.boxes] + [f.heights.min() for f in tile.fields]
      lowest, highest = min(lowest, *bottoms), max(highest, *tops)
    return Terrain(
      name=self.name,
      geom_names=geom_names,
      tile_size=self.tile_size,
      origins=origins,
      difficulty=difficulty,
      type_names=tuple(self._used()),
      tile_types=kinds,
      column_shares=column_shares,
      flat_patches=patches,
      height_range=(float(lowest), float(highest)),
    )
