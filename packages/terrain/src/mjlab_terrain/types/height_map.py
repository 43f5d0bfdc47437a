"""Ground from a height map: an array or a picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image

from mjlab_terrain.checked_fields import number, scaled
from mjlab_terrain.solids import Floats
from mjlab_terrain.tile import Tile
from mjlab_terrain.tile_cfg import BorderedTileCfg


@dataclass(kw_only=True)
class HeightMapCfg(BorderedTileCfg):
  """Height map, stretched over the tile.

  Harder: higher, if the two values of `height` differ; by default, difficulty has no effect.
  """

  source: ArrayLike | str | Path
  """Heights at the vertices of a regular grid, first index along x, second along y, (nx, ny); or the file of a picture,
  with x to the right, y up, and grey from 0, black, to 1, white."""
  height: tuple[float, float] = scaled((1.0, 1.0), harder="more")
  """Height of the value 1 of `source` [m]."""
  border: float = number(0.0)
  """Width of the level rim at height 0 [m]."""
  blend: float = number(0.0)
  """Width over which the heights grow from the border inwards [m]. Without border and blend they do not change."""

  def check(self, name: str, size: tuple[float, float]) -> None:
    super().check(name, size)
    try:
      heights = self._heights()
    except (OSError, ValueError, TypeError, ImportError) as error:
      self.refuse(name, f"the height map {source_name(self.source)} cannot be read: {error}")
    if heights.ndim != 2 or min(heights.shape) < 2 or not np.isfinite(heights).all():
      self.refuse(name, f"a height map must be (nx, ny), at least (2, 2), and finite; got {heights.shape}")

  def _heights(self) -> Floats:
    if isinstance(self.source, str | Path):
      return _read_picture(Path(self.source))
    return np.asarray(self.source, dtype=np.float64)

  def build(self, tile: Tile) -> None:
    z = self._heights() * tile.scaled(self.height)
    if self.border > 0.0 or self.blend > 0.0:
      x, y = (np.linspace(-0.5 * s, 0.5 * s, n) for s, n in zip(tile.size, z.shape, strict=True))
      z = z * tile.fade(x[:, None], y[None, :], self.border, self.blend)
    tile.heights(z)


def source_name(source: object) -> str:
  """Return a short name of a source of ground, for messages."""
  return f"'{source}'" if isinstance(source, str | Path) else f"of type {type(source).__name__}"


def _read_picture(path: Path) -> Floats:
  with Image.open(path) as image:
    # 16-bit pictures keep their depth; all others become 8-bit grey.
    deep = image.mode.startswith("I") or image.mode == "F"
    values = np.asarray(image if deep else image.convert("L"), dtype=np.float64)
    full = 1.0 if image.mode == "F" else 65535.0 if deep else 255.0
  return values[::-1].T / full
