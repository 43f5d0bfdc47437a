"""Terrain as triangles with colors, for programs that draw them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.assembly import gather
from mjlab_terrain.colors import GroundColor, as_pixels, color_of
from mjlab_terrain.solids import HeightField
from mjlab_terrain.tile import Tile

# Sides of a box as two triangles each: indices of its corners, counter-clockwise as seen from outside.
_SIDES = np.array(
  [
    [0, 1, 3],
    [0, 3, 2],
    [4, 6, 7],
    [4, 7, 5],
    [0, 4, 5],
    [0, 5, 1],
    [2, 3, 7],
    [2, 7, 6],
    [0, 2, 6],
    [0, 6, 4],
    [1, 5, 7],
    [1, 7, 3],
  ]
)


def triangles(
  tiles: Sequence[Tile], color: GroundColor
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.uint8]]:
  """Return vertices (n, 3) [m] in the world frame, triangles (m, 3), and colors of vertices (n, 3) in [0, 255]."""
  vertices, faces, colors = [], [], []
  count = 0
  for solid, kind in gather(tiles):
    if isinstance(solid, HeightField):
      nx, ny = solid.heights.shape
      x, y = (np.linspace(-half, half, num) for half, num in zip(solid.half, (nx, ny), strict=True))
      points = solid.center + np.stack((*np.meshgrid(x, y, indexing="ij"), solid.heights), -1).reshape(-1, 3)
      near = (np.arange(nx - 1)[:, None] * ny + np.arange(ny - 1)).ravel()
      cells = np.stack((near, near + ny, near + ny + 1), -1), np.stack((near, near + ny + 1, near + 1), -1)
      faces.append(np.concatenate(cells) + count)
      colors.append(color_of(color, kind, points[:, 2]))
    else:
      # Vertices are not shared between sides, so that edges stay sharp.
      points = solid.corners[_SIDES].reshape(-1, 3)
      faces.append(np.arange(36).reshape(-1, 3) + count)
      colors.append(color_of(color, kind, np.full(36, solid.center[2])))
    vertices.append(points)
    count += len(points)
  return np.concatenate(vertices), np.concatenate(faces), as_pixels(np.concatenate(colors))
