"""Description of a terrain that is part of a model."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Terrain:
  """Terrain that has been added to an `MjSpec`: tiles in rows, which run along x, and columns, which run along y.

  A plane is one infinite tile. In a curriculum, rows go from easy to hard and a column has one type.
  """

  name: str
  """Name of its static body, which has all its geoms."""

  geom_names: tuple[str, ...]
  """Names of its geoms."""

  tile_size: tuple[float, float] = (math.inf, math.inf)
  """Extent of a tile along x and y [m]."""

  origins: NDArray[np.float64] = field(default_factory=lambda: np.zeros((1, 1, 3)))
  """Spawn point of each tile, on the surface, world frame, (rows, columns, 3) [m]."""

  difficulty: NDArray[np.float64] = field(default_factory=lambda: np.zeros((1, 1)))
  """Difficulty of each tile in [0, 1], (rows, columns)."""

  type_names: tuple[str, ...] = ("plane",)
  """Names of the types of tile."""

  tile_types: NDArray[np.int64] = field(default_factory=lambda: np.zeros((1, 1), dtype=np.int64))
  """Type of each tile, an index into `type_names`, (rows, columns)."""

  column_shares: NDArray[np.float64] = field(default_factory=lambda: np.ones(1))
  """Share of all worlds on each column, (columns,); shares sum to 1."""

  flat_patches: dict[str, NDArray[np.float64]] = field(default_factory=dict)
  """Centres of flat places of each tile, on the surface, by name, world frame, (rows, columns, count, 3) [m]."""

  height_range: tuple[float, float] = (0.0, 0.0)
  """Lowest and highest point of the surface [m]; solids below it do not count."""

  def columns_of(self, num: int) -> NDArray[np.int64]:
    """Return the column of each of `num` worlds, (num,): every column has its share, spread evenly over the worlds."""
    return self._places_of(num)[1]

  def env_origins(self, num: int, spacing: float) -> NDArray[np.float64]:
    """Return the origins of `num` worlds on the surface, world frame, (num, 3) [m].

    On tiles each column has its share of worlds, which are spread over its rows; on a plane, see `grid_origins`.
    """
    if math.isinf(self.tile_size[0]):
      return grid_origins(num, spacing)
    nth, column = self._places_of(num)
    return self.origins[nth % len(self.origins), column]

  def _places_of(self, num: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the number of each world among those of its column, and its column, both (num,)."""
    counts = apportion(self.column_shares, num)
    column = np.repeat(np.arange(len(counts)), counts)
    nth = np.concatenate([np.arange(n) for n in counts])
    # The k-th world of a column with n worlds stands at (k + 1/2) / n of the sequence.
    order = np.lexsort((column, (nth + 0.5) / counts[column]))
    return nth[order], column[order]


def apportion(shares: NDArray[np.float64], num: int) -> NDArray[np.int64]:
  """Divide `num` things among shares, which sum to 1, by largest remainder, (len(shares),)."""
  exact = shares * num
  counts = np.floor(exact + 1e-9).astype(np.int64)
  # Stable, so that of equal remainders the first is served.
  order = np.argsort(counts - exact, kind="stable")
  counts[order[: num - counts.sum()]] += 1
  return counts


def grid_origins(num: int, spacing: float) -> NDArray[np.float64]:
  """Return the origins of `num` worlds on a nearly square grid around zero, at height zero, (num, 3) [m].

  Rows run along negative x and are filled along positive y, `spacing` [m] apart.
  """
  rows = math.ceil(num / math.isqrt(num))
  columns = math.ceil(num / rows)
  i, j = np.divmod(np.arange(num), columns)
  x = (0.5 * (rows - 1) - i) * spacing
  y = (j - 0.5 * (columns - 1)) * spacing
  return np.stack((x, y, np.zeros(num)), axis=-1)
