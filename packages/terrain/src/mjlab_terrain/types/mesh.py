"""Ground from a mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjlab_terrain.checked_fields import number, scaled
from mjlab_terrain.solids import Floats
from mjlab_terrain.tile import Tile
from mjlab_terrain.tile_cfg import TileCfg
from mjlab_terrain.types.height_map import source_name


@dataclass(kw_only=True)
class MeshCfg(TileCfg):
  """Mesh as ground: its surface as seen from above. Space below an overhang is filled.

  Harder: higher, if the two factors of `height` differ; by default, difficulty has no effect. MuJoCo collides with the
  convex hull of a mesh. The ground is therefore a height field, with sides as steep as one cell allows.
  """

  source: str | Path | tuple[ArrayLike, ArrayLike]
  """File of any format that `trimesh` reads; or vertices, (n, 3) [m], and triangles, (m, 3), as indices of vertices. z
  is up. The middle of the mesh, seen from above, becomes the middle of the tile."""
  scale: float = number(1.0, least=1e-6)
  """Factor on all lengths of the mesh."""
  height: tuple[float, float] = scaled((1.0, 1.0), harder="more")
  """Additional factor on the heights of the mesh."""
  floor: float = number(0.0, least=-math.inf)
  """Height of the ground beside the mesh [m]."""
  resolution: float = number(0.05, least=0.005)
  """Distance between the vertices of the height field [m]."""

  def check(self, name: str, size: tuple[float, float]) -> None:
    super().check(name, size)
    extent = np.ptp(self._mesh(name)[0], axis=0)[:2]
    if (extent > np.array(size) + 1e-6).any():
      scale = self.scale * np.floor(1e3 * np.min(np.array(size) / extent)) / 1e3
      self.refuse(
        name,
        f"the mesh is {extent[0]:.3g} x {extent[1]:.3g} m, the tile {size[0]:g} x {size[1]:g} m; "
        f"a scale of at most {scale:.3g}, or a tile of its size, would work",
      )

  def natural_size(self) -> tuple[float, float]:
    x, y, _ = np.ptp(self._mesh("tile")[0], axis=0)
    return float(x), float(y)

  def _mesh(self, name: str) -> tuple[Floats, NDArray[np.int64]]:
    """Return vertices, centred and scaled, (n, 3) [m], and triangles, (m, 3); `name` is the type's in messages."""
    try:
      if isinstance(self.source, str | Path):
        path = Path(self.source)
        source = _read_mesh(path, path.stat().st_mtime_ns)
      else:
        source = self.source
      vertices, faces = np.array(source[0], dtype=np.float64) * self.scale, np.asarray(source[1], dtype=np.int64)
      if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,) or not len(faces):
        raise ValueError(f"vertices must be (n, 3) and triangles (m, 3), got {vertices.shape} and {faces.shape}")
      # Vertices that no triangle uses do not count.
      used, faces = np.unique(faces, return_inverse=True)
      vertices = vertices[used]
    except Exception as error:  # Readers of many formats fail in many ways.
      self.refuse(name, f"the mesh {source_name(self.source)} cannot be read: {error}")
    vertices[:, :2] -= 0.5 * (vertices.min(0) + vertices.max(0))[:2]
    return vertices, faces.reshape(-1, 3)

  def build(self, tile: Tile) -> None:
    x, y = tile.grid(self.resolution)
    z = seen_from_above(*self._mesh("tile"), x.ravel(), y.ravel())
    tile.heights(np.where(np.isfinite(z), z, self.floor) * tile.scaled(self.height))


@lru_cache(maxsize=8)
def _read_mesh(path: Path, changed: int) -> tuple[Any, Any]:
  """Return vertices and triangles of a file; `changed` is its time of writing, so that a new file is read again."""
  try:
    trimesh: Any = import_module("trimesh")
  except ImportError as error:
    raise ImportError("meshes need trimesh, of the extra 'mesh' of mjlab-terrain") from error
  mesh = trimesh.load(path, force="mesh")
  return mesh.vertices, mesh.faces


def seen_from_above(vertices: Floats, faces: NDArray[np.int64], x: Floats, y: Floats) -> Floats:
  """Return the height of the highest triangle at the points of a regular grid, (nx, ny) [m]; -inf without one."""
  top = np.full((len(x), len(y)), -np.inf)
  start, step = np.array((x[0], y[0])), np.array((x[1] - x[0], y[1] - y[0]))
  corners = vertices[faces]
  # A vertical triangle is seen from the side only; its edges belong to its neighbours.
  corners = corners[np.abs(np.linalg.det((corners[:, 1:] - corners[:, :1])[..., :2])) > 1e-12]
  sides = corners[:, 1:] - corners[:, :1]
  inverse = np.linalg.inv(sides[..., :2])
  low = np.ceil((corners.min(1)[:, :2] - start) / step - 1e-6).astype(np.int64).clip(0)
  high = np.floor((corners.max(1)[:, :2] - start) / step + 1e-6).astype(np.int64).clip(max=np.array(top.shape) - 1)
  widths = np.maximum(high - low + 1, 0)
  counts = widths.prod(1)
  # Every candidate, a triangle and a point in its bounding box, is one element; a few million at a time.
  for chunk in np.array_split(np.arange(len(corners)), max(int(counts.sum() // 2_000_000), 1)):
    t = np.repeat(chunk, counts[chunk])
    nth = np.arange(len(t)) - np.repeat(np.cumsum(counts[chunk]) - counts[chunk], counts[chunk])
    point = low[t] + np.column_stack(np.divmod(nth, widths[t, 1]))
    # Coordinates of the point along both sides of the triangle.
    along = ((start + point * step - corners[t, 0, :2])[:, None] @ inverse[t])[:, 0]
    inside = (along.min(1) >= -1e-9) & (along.sum(1) <= 1.0 + 1e-9)
    z = corners[t, 0, 2] + (along * sides[t, :, 2]).sum(1)
    np.maximum.at(top, tuple(point[inside].T), z[inside])
  return top
