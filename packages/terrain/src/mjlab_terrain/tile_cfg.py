"""What all types of tile have in common: their settings, which are checked before anything is built."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal, NoReturn

from mjlab_terrain.tile import MIN_THICKNESS, Tile

if TYPE_CHECKING:
  import mujoco

  from mjlab_terrain.terrain import Terrain


def scaled(
  ends: tuple[float, float], *, harder: Literal["more", "less"], least: float = 0.0, most: float = math.inf
) -> Any:
  """A setting that difficulty changes: its value at difficulty 0 and at 1. `harder` says which way it may go."""
  return field(default=ends, metadata={"kind": "scaled", "harder": harder, "least": least, "most": most})


def drawn(ends: tuple[float, float], *, least: float = 0.0, most: float = math.inf) -> Any:
  """A setting that is drawn at random: its lowest and highest value."""
  return field(default=ends, metadata={"kind": "drawn", "least": least, "most": most})


def number(value: float | None, *, least: float = 0.0, most: float = math.inf) -> Any:
  """A setting with one value. If the default is a whole number, it has to be one; if it is None, it may be None."""
  return field(default=value, metadata={"kind": "number", "least": least, "most": most})


@dataclass(kw_only=True)
class TileCfg(ABC):
  """A type of tile. A new type is a dataclass with `build`; settings from `scaled`, `drawn` and `number` are checked.

  Types have their rim at height 0, so that neighbours meet, and a flat place or a crest to spawn on.
  """

  share: float = number(1.0)
  """How much of a grid is of this type, relative to the shares of the other types."""

  @abstractmethod
  def build(self, tile: Tile) -> None:
    """Adds the geometry to an empty tile. It depends on the settings and the tile's size, difficulty and rng alone."""

  def check(self, name: str, size: tuple[float, float]) -> None:
    """Checks the settings for tiles of this size [m]; `name` is how messages call the type.

    Raises:
      ValueError: a setting is out of its range, or does not fit; the message says what would.
    """
    for f in fields(self):
      if "kind" in f.metadata:
        self._check_setting(name, f.name, f.metadata, f.default)
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
    """Raises a ValueError about this type, called `name`."""
    raise ValueError(f"{type(self).__name__} '{name}': {message}.")

  def natural_size(self) -> tuple[float, float]:
    """Extent of a tile of this type along x and y [m] where nobody says another."""
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
    """Adds a terrain of one such tile to `spec`, with nothing around it; see `TerrainGridCfg.add_to`."""
    # The grid is made of tiles and knows them.
    from mjlab_terrain.grid import TerrainGridCfg

    grid = TerrainGridCfg(
      name=name,
      tile_size=tile_size or self.natural_size(),
      rows=1,
      columns=1,
      difficulty=(difficulty, difficulty),
      border_width=0.0,
      types={"tile": self},
      seed=seed,
    )
    return grid.add_to(spec)

  def _check_setting(self, name: str, setting: str, rule: Any, default: Any) -> None:
    value: Any = getattr(self, setting)
    least, most = rule["least"], rule["most"]
    if value is None and default is None:
      return
    if rule["kind"] == "number":
      if isinstance(default, int) and not isinstance(value, int):
        self.refuse(name, f"{setting} must be a whole number, got {value!r}")
      values: tuple[Any, ...] = (value,)
    else:
      if not (isinstance(value, tuple | list) and len(value) == 2):
        ends = "easiest, hardest" if rule["kind"] == "scaled" else "lowest, highest"
        self.refuse(name, f"{setting} must be ({ends}), got {value!r}")
      values = tuple(value)
    if not all(math.isfinite(v) for v in values):
      self.refuse(name, f"{setting} must be finite, got {value!r}")
    possible = tuple(min(max(v, least), most) for v in values)
    if possible != values:
      instead = possible[0] if rule["kind"] == "number" else tuple(float(p) for p in possible)
      bounds = f"at least {least:g}" if math.isinf(most) else f"between {least:g} and {most:g}"
      self.refuse(name, f"{setting} {value!r} must be {bounds}; {instead} would work")
    if rule["kind"] == "number":
      return
    first, second = values[0], values[1]
    down = rule.get("harder") == "less"
    if (first < second) if down else (first > second):
      rule_of = f"{'fall' if down else 'grow'} with difficulty" if rule["kind"] == "scaled" else "go from low to high"
      self.refuse(name, f"{setting} {value!r} is the wrong way round: it must {rule_of}; {(second, first)} would work")
