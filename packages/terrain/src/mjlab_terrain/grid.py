"""Terrain of many tiles."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.assembly import FRICTION, add_tiles
from mjlab_terrain.checked_fields import check_fields, choice, drawn, number, refuse
from mjlab_terrain.colors import GroundColor
from mjlab_terrain.patches import FlatPatchCfg
from mjlab_terrain.presets import walking_types
from mjlab_terrain.solids import GROUND_DEPTH, Solid
from mjlab_terrain.terrain import Terrain, apportion
from mjlab_terrain.tile import Tile
from mjlab_terrain.tile_cfg import TileCfg, tile_rng

# Keys of other uses of a seed. The key of a tile is its row and column.
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
  """Types of tile by name. Types with share 0 are left out."""

  tile_size: tuple[float, float] = number((8.0, 8.0), least=0.5)
  """Extent of a tile along x and y [m]."""

  rows: int = number(10, least=1)
  """Number of tiles along x."""

  columns: int | None = number(None, least=1, whole=True)
  """Number of tiles along y; None for one of each type in a curriculum, and for as many as rows in a random layout."""

  layout: Literal["curriculum", "random"] = choice("curriculum", "random")
  """Curriculum: rows go from easy to hard, and each type has columns by its share. Random: all is drawn."""

  difficulty: tuple[float, float] = drawn((0.0, 1.0), most=1.0)
  """Difficulty of the easiest and the hardest tiles, in [0, 1]."""

  seed: int = number(0)
  """Seed of all randomness."""

  border_width: float = number(10.0)
  """Width of the level ground around the grid [m]."""

  color: GroundColor = "height"
  """Meaning of the color, or one color for all: red, green and blue in [0, 1]."""

  friction: tuple[float, float, float] = number(FRICTION)
  """Sliding, torsional and rolling friction [1, m, m]."""

  flat_patches: dict[str, FlatPatchCfg] = field(default_factory=dict)
  """Sets of level places that are searched on every tile, by name."""

  light: bool = True
  """True adds a directional light from above."""

  def add_to(self, spec: mujoco.MjSpec) -> Terrain:
    """Add a static body with the whole grid to the world of `spec`, in geom group 0.

    Raises:
      ValueError: a setting is out of its range, or `spec` already has a body or a geom of a name that is needed;
        `spec` is unchanged.
    """
    tiles = self.tiles()
    kinds, _, shares = self._plan()
    rows, columns = kinds.shape
    patches = {}
    for k, (name, cfg) in enumerate(self.flat_patches.items()):
      found = [tile.center + cfg.find(tile, tile_rng(self.seed, *tile.place, _PATCHES, k)) for tile in tiles]
      patches[name] = np.reshape(found, (rows, columns, cfg.count, 3))
    return add_tiles(
      spec,
      self.name,
      tiles,
      self._border(rows, columns),
      color=self.color,
      friction=self.friction,
      light=self.light,
      type_names=tuple(self._used()),
      column_shares=shares,
      flat_patches=patches,
    )

  def tiles(self) -> list[Tile]:
    """Return all tiles, row by row.

    Raises:
      ValueError: a setting is out of its range; the message says what would work.
    """
    self.check()
    kinds, difficulty, _ = self._plan()
    cfgs = list(self._used().items())
    tiles = []
    for place in np.ndindex(*kinds.shape):
      center = np.append((place - 0.5 * (np.array(kinds.shape) - 1)) * self.tile_size, 0.0)
      kind, rng = int(kinds[place]), tile_rng(self.seed, *place)
      tile = Tile(self.tile_size, float(difficulty[place]), rng, place=place, kind=kind, center=center)
      name, cfg = cfgs[kind]
      tiles.append(cfg.built(name, tile))
    return tiles

  def check(self) -> None:
    """Check all settings.

    Raises:
      ValueError: a setting is out of its range; the message names it and what would work.
    """
    check_fields(self, self.name)
    if isinstance(self.color, str) and self.color not in ("height", "type"):
      refuse(self, self.name, f"color must be 'height', 'type' or three numbers in [0, 1], got {self.color!r}")
    for name, cfg in self.types.items():
      cfg.check(name, self.tile_size)
    used = self._used()
    if not used:
      refuse(self, self.name, f"the shares of types {list(self.types)} sum to 0; give one of them a share of 1")
    if self.layout == "curriculum" and self.columns is not None and self.columns < len(used):
      few = f"{self.columns} columns are too few for the types {', '.join(used)}; at least {len(used)} would work"
      refuse(self, self.name, few)
    for name, patch in self.flat_patches.items():
      patch.check(name, self.tile_size)

  def _used(self) -> dict[str, TileCfg]:
    return {name: cfg for name, cfg in self.types.items() if cfg.share > 0.0}

  def _plan(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the type and difficulty of each tile, both (rows, columns), and the share of worlds of each column."""
    low, high = self.difficulty
    shares = np.array([cfg.share for cfg in self._used().values()], dtype=np.float64)
    shares /= shares.sum()
    if self.layout == "random":
      rng = tile_rng(self.seed, _LAYOUT)
      rows, columns = self.rows, self.columns or self.rows
      kinds = rng.choice(len(shares), size=(rows, columns), p=shares)
      return kinds, rng.uniform(low, high, (rows, columns)), np.full(columns, 1.0 / columns)
    spare = 0 if self.columns is None else self.columns - len(shares)
    # The claim of a type beyond its first column.
    owed = np.maximum(shares * (len(shares) + spare) - 1.0, 0.0)
    counts = 1 + apportion(owed / owed.sum() if owed.any() else shares, spare)
    kinds = np.tile(np.repeat(np.arange(len(shares)), counts), (self.rows, 1))
    difficulty = np.broadcast_to(np.linspace(low, high, self.rows)[:, None], kinds.shape)
    return kinds, difficulty, np.repeat(shares / counts, counts)

  def _border(self, rows: int, columns: int) -> list[Solid]:
    """Return the level ground around the tiles."""
    x, y = np.multiply((rows, columns), self.tile_size) + 2.0 * self.border_width
    around = Tile((x, y), 0.0, tile_rng(self.seed, _LAYOUT))
    around.ring(0.0, self.border_width, (-GROUND_DEPTH, 0.0))
    return around.solids
