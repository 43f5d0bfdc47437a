"""A terrain as triangles with colors, for programs that draw them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.assembly import Coloring, PlacedTile, gather
from mjlab_terrain.tile import Box

# Corners of the cube [-1, 1]^3 and its sides, two triangles each, seen from outside counter-clockwise.
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
_SIDES = np.array(
  [
    *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5]),
    *([0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]),
    *([0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
  ]
)


def triangles(
  placed: Sequence[PlacedTile], border: Sequence[Box], coloring: Coloring
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.uint8]]:
  """Vertices (n, 3) [m] in the world frame, triangles (m, 3), and colors of vertices (n, 3) in [0, 255]."""
  vertices, faces, colors = [], [], []
  boxes, fields = gather(placed, border)
  count = 0
  for box, kind in boxes:
    corners = _CORNERS * box.half
    # Vertices are not shared between sides, so that edges stay sharp.
    corners = (corners if box.rotation is None else corners @ box.rotation.T)[_SIDES].reshape(-1, 3)
    vertices.append(corners + box.center)
    faces.append(np.arange(36).reshape(-1, 3) + count)
    colors.append(np.tile(coloring(kind, np.array(box.center[2] + box.half[2])), (36, 1)))
    count += 36
  for field, center, kind in fields:
    nx, ny = field.heights.shape
    x, y = np.meshgrid(np.linspace(*field.x, nx), np.linspace(*field.y, ny), indexing="ij")
    vertices.append(np.stack((x, y, field.heights), -1).reshape(-1, 3) + center)
    near = (np.arange(nx - 1)[:, None] * ny + np.arange(ny - 1)).ravel() + count
    faces.append(
      np.concatenate([np.stack((near, near + ny, near + ny + 1), -1), np.stack((near, near + ny + 1, near + 1), -1)])
    )
    colors.append(coloring(kind, field.heights).reshape(-1, 3))
    count += nx * ny
  rgb = np.round(255.0 * np.clip(np.concatenate(colors), 0.0, 1.0)).astype(np.uint8)
  return np.concatenate(vertices), np.concatenate(faces), rgb
