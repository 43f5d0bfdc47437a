"""Base class of the types of tile."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NoReturn

import mujoco
import numpy as np

from mjlab_terrain.assembly import add_body, gather, height_range, place_tile
from mjlab_terrain.checked_fields import check_fields, number, refuse
from mjlab_terrain.colors import coloring_of
from mjlab_terrain.solids import MIN_THICKNESS
from mjlab_terrain.terrain import Terrain
from mjlab_terrain.tile import Tile


@dataclass(kw_only=True)
class TileCfg(ABC):
  """Type of tile. A new type is a dataclass with `build`; fields from `scaled`, `drawn` and `number` are checked.

  The rim of a tile is at height 0, so that neighbours meet, and a flat place or a crest is there to spawn on.
  """

  share: float = number(1.0)
  """Share of the grid that is of this type, relative to the shares of the other types."""

  @abstractmethod
  def build(self, tile: Tile) -> None:
    """Add the geometry to an empty tile. It depends on the settings and the tile's size, difficulty and rng alone."""

  def check(self, name: str, size: tuple[float, float]) -> None:
    """Check the settings for tiles of this size [m]; `name` is the type's name in messages.

    Raises:
      ValueError: a setting is out of its range, or does not fit; the message says what would.
    """
    check_fields(self, name)
    border, platform = getattr(self, "border", 0.0), getattr(self, "platform", 0.0)
    if 0.0 < border < MIN_THICKNESS:
      self.refuse(name, f"border {border:g} m is thinner than a geom may be; use 0, or at least {MIN_THICKNESS} m")
    if min(size) < 2.0 * border + platform + 2.0 * MIN_THICKNESS:
      room = min(size) - 2.0 * border - 2.0 * MIN_THICKNESS
      way_out = (
        f"make the platform at most {room:g} m" if room > 0.0 else f"make the border at most {min(size) / 4:g} m"
      )
      self.refuse(
        name,
        f"platform {platform:g} m and border {border:g} m do not fit into a tile of {size[0]:g} x {size[1]:g} m; "
        f"{way_out}, or the tile at least {2.0 * border + platform + 2.0 * MIN_THICKNESS:g} m",
      )

  def refuse(self, name: str, message: str) -> NoReturn:
    """Raise a ValueError about this type, called `name`."""
    refuse(self, name, message)

  def natural_size(self) -> tuple[float, float]:
    """Return the default extent of a tile of this type along x and y [m]."""
    return 8.0, 8.0

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
      ValueError: a setting is out of its range, or `spec` already has an element of a name that is needed; `spec` is
        unchanged.
    """
    size = tile_size or self.natural_size()
    self.check("tile", size)
    if not 0.0 <= difficulty <= 1.0:
      self.refuse("tile", f"difficulty must be between 0 and 1, got {difficulty}")
    tile = Tile(size, difficulty, tile_rng(seed, 0, 0))
    placed = place_tile(
      self.build, f"{type(self).__name__} 'tile'", tile, row=0, column=0, kind=0, center=np.zeros(3)
    )  # fmt: skip
    return Terrain(
      name=name,
      geom_names=add_body(spec, name, gather([placed]), coloring_of("height")),
      tile_size=size,
      origins=placed.origin[None, None],
      difficulty=np.array([[difficulty]]),
      type_names=("tile",),
      height_range=height_range([placed]),
    )


def tile_rng(seed: int, *key: int) -> np.random.Generator:
  """Return the random numbers of a tile, given by its row and column, or of another use of a seed."""
  return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
