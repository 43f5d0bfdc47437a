"""Terrain as triangles with colors, for programs that draw them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.assembly import PlacedTile, gather
from mjlab_terrain.colors import Coloring
from mjlab_terrain.solids import HeightField, Prism

# Corners of the cube [-1, 1]^3 in the order of those of a prism, and its sides as two triangles each, whose corners are
# counter-clockwise as seen from outside.
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
_SIDES = np.array(
  [
    *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5]),
    *([0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]),
    *([0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
  ]
)


def triangles(
  placed: Sequence[PlacedTile], coloring: Coloring
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.uint8]]:
  """Return vertices (n, 3) [m] in the world frame, triangles (m, 3), and colors of vertices (n, 3) in [0, 255]."""
  vertices, faces, colors = [], [], []
  count = 0
  for solid, kind in gather(placed):
    if isinstance(solid, HeightField):
      nx, ny = solid.heights.shape
      x, y = np.meshgrid(np.linspace(*solid.x, nx), np.linspace(*solid.y, ny), indexing="ij")
      points = np.stack((x, y, solid.heights), -1).reshape(-1, 3)
      near = (np.arange(nx - 1)[:, None] * ny + np.arange(ny - 1)).ravel()
      cells = np.stack((near, near + ny, near + ny + 1), -1), np.stack((near, near + ny + 1, near + 1), -1)
      triangles_of = np.concatenate(cells)
      heights = solid.heights.ravel()
    else:
      if isinstance(solid, Prism):
        corners = solid.corners
      else:
        offsets = _CORNERS * solid.half
        corners = solid.center + (offsets if solid.rotation is None else offsets @ solid.rotation.T)
      # Vertices are not shared between sides, so that edges stay sharp.
      points = corners[_SIDES].reshape(-1, 3)
      triangles_of = np.arange(36).reshape(-1, 3)
      heights = np.full(36, solid.color_height)
    vertices.append(points)
    faces.append(triangles_of + count)
    colors.append(coloring(kind, heights))
    count += len(points)
  rgb = np.round(255.0 * np.clip(np.concatenate(colors), 0.0, 1.0)).astype(np.uint8)
  return np.concatenate(vertices), np.concatenate(faces), rgb
