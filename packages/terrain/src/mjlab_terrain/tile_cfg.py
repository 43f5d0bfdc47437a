"""Base class of the types of tile."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import NoReturn

import mujoco
import numpy as np

from mjlab_terrain.assembly import add_tiles
from mjlab_terrain.checked_fields import check_fields, number, refuse, rule_of
from mjlab_terrain.solids import MIN_THICKNESS
from mjlab_terrain.terrain import Terrain
from mjlab_terrain.tile import Tile


@dataclass(kw_only=True)
class TileCfg(ABC):
  """Type of tile. A new type is a dataclass with `build`; fields from `scaled`, `drawn` and `number` are checked.

  The rim of a tile is at height 0, so that neighbours meet. A tile has a flat place or a crest to spawn on.
  """

  share: float = number(1.0)
  """Share of this type in a grid, relative to the shares of the other types."""

  @abstractmethod
  def build(self, tile: Tile) -> None:
    """Add the geometry to an empty tile. It depends on the settings and the tile's size, difficulty and rng alone."""

  def check(self, name: str, size: tuple[float, float]) -> None:
    """Check the settings for tiles of this size [m]; `name` is the type's name in messages.

    Raises:
      ValueError: a setting is out of its range, or does not fit; the message says what would.
    """
    check_fields(self, name)

  def refuse(self, name: str, message: str) -> NoReturn:
    """Raise a ValueError about this type, called `name`."""
    refuse(self, name, message)

  def natural_size(self) -> tuple[float, float]:
    """Return the default extent of a tile of this type along x and y [m]."""
    return 8.0, 8.0

  def built(self, name: str, tile: Tile) -> Tile:
    """Return a tile after `build`; `name` is the type's name in messages.

    Raises:
      ValueError: `build` fails, or adds nothing.
    """
    label = f"{type(self).__name__} '{name}'"
    try:
      self.build(tile)
    except ValueError as error:
      raise ValueError(f"{label}: at difficulty {tile.difficulty:.3g}, tile {tile.place}: {error}") from error
    if not tile.solids:
      raise ValueError(f"{label}: build added no geometry to the tile.")
    return tile

  def add_to(
    self,
    spec: mujoco.MjSpec,
    *,
    tile_size: tuple[float, float] | None = None,
    difficulty: float = 0.5,
    seed: int = 0,
    name: str = "terrain",
  ) -> Terrain:
    """Add a terrain of one such tile to `spec`, with nothing around it, and a directional light.

    Raises:
      ValueError: a setting is out of its range, or `spec` already has a body or a geom of a name that is needed;
        `spec` is unchanged.
    """
    size = tile_size or self.natural_size()
    self.check("tile", size)
    tile = self.built("tile", Tile(size, difficulty, tile_rng(seed, 0, 0)))
    return add_tiles(spec, name, [tile], type_names=("tile",))


@dataclass(kw_only=True)
class BorderedTileCfg(TileCfg):
  """Type of tile with a level rim; its field `platform`, if any, is the edge of the level square in the middle."""

  border: float = number(0.25)
  """Width of the level rim [m]."""

  def check(self, name: str, size: tuple[float, float]) -> None:
    super().check(name, size)
    platform, tile = getattr(self, "platform", 0.0), f"a tile of {size[0]:g} x {size[1]:g} m"
    inside = min(size) - 2.0 * self.border
    room = inside - 2.0 * MIN_THICKNESS
    if platform > room:
      way_out = f"the platform at most {room:g} m" if room > 0.0 else f"the border at most {min(size) / 4:g} m"
      self.refuse(
        name,
        f"platform {platform:g} m and border {self.border:g} m do not fit into {tile}; "
        f"make {way_out}, or the tile at least {min(size) + platform - room:g} m",
      )
    for f in fields(self):
      if rule_of(f).get("inside") and np.max(getattr(self, f.name)) > inside:
        got = f"{f.name} {getattr(self, f.name)} does not fit inside the border of {tile}"
        self.refuse(name, f"{got}; at most {inside:g} m would work")


def tile_rng(seed: int, *key: int) -> np.random.Generator:
  """Return the random numbers of a tile, with its row and column as key, or of another use of a seed."""
  return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
