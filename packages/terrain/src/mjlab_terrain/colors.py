"""Colors of the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Rgb = tuple[float, float, float]

# Height [m] and color: deep water, slate, stone at the rim's height, sand, clay.
_GRADIENT: tuple[tuple[float, Rgb], ...] = (
  (-2.0, (0.08, 0.11, 0.17)),
  (-1.0, (0.13, 0.24, 0.36)),
  (-0.4, (0.24, 0.43, 0.52)),
  (0.0, (0.58, 0.65, 0.62)),
  (0.3, (0.85, 0.76, 0.56)),
  (0.8, (0.82, 0.52, 0.33)),
  (2.0, (0.62, 0.25, 0.22)),
)

_TYPES: tuple[Rgb, ...] = (
  (0.56, 0.60, 0.62),
  (0.36, 0.53, 0.70),
  (0.83, 0.55, 0.35),
  (0.47, 0.64, 0.47),
  (0.70, 0.45, 0.50),
  (0.55, 0.50, 0.72),
  (0.80, 0.70, 0.42),
  (0.40, 0.63, 0.64),
  (0.72, 0.58, 0.70),
  (0.60, 0.62, 0.36),
)


def height_color(z: NDArray[np.float64] | float) -> NDArray[np.float64]:
  """Color of ground at height `z` [m], (..., 3) in [0, 1]."""
  at, colors = [z for z, _ in _GRADIENT], np.array([rgb for _, rgb in _GRADIENT])
  return np.stack([np.interp(z, at, colors[:, k]) for k in range(3)], axis=-1)


def type_color(index: int, z: NDArray[np.float64] | float) -> NDArray[np.float64]:
  """Color of ground of the type with this index at height `z` [m], darker below the rim and lighter above, (..., 3)."""
  shade = np.clip(1.0 + 0.35 * np.asarray(z, dtype=np.float64), 0.45, 1.6)
  return np.clip(np.array(_TYPES[index % len(_TYPES)]) * shade[..., None], 0.0, 1.0)
