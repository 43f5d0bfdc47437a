"""What a terrain tells its user after it has been added to a model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Terrain:
  """A terrain that has been added to an `MjSpec`."""

  name: str
  """Name of its body, which is static and holds all its geoms."""

  geom_names: tuple[str, ...]
  """Names of its geoms."""

  def env_origins(self, num: int, spacing: float) -> NDArray[np.float64]:
    """Where `num` worlds have their origin on the surface, world frame, (num, 3) [m]; see `grid_origins`."""
    return grid_origins(num, spacing)


def grid_origins(num: int, spacing: float) -> NDArray[np.float64]:
  """Origins of `num` worlds on a nearly square grid around zero, at height zero, (num, 3) [m].

  Rows run along negative x and are filled along positive y, `spacing` [m] apart.

  Raises:
    ValueError: `num` is not positive, or `spacing` is negative or not finite.
  """
  if num < 1:
    raise ValueError(f"grid_origins: num must be at least 1, got {num}.")
  if not 0.0 <= spacing < math.inf:
    raise ValueError(f"grid_origins: spacing must be a finite length, not negative, got {spacing}.")
  rows = math.ceil(num / math.isqrt(num))
  columns = math.ceil(num / rows)
  i, j = np.divmod(np.arange(num), columns)
  x = (0.5 * (rows - 1) - i) * spacing
  y = (j - 0.5 * (columns - 1)) * spacing
  return np.stack((x, y, np.zeros(num)), axis=-1)
