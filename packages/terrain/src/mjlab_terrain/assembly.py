"""Tiles as one static body of an `MjSpec`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.colors import Coloring, picture_of
from mjlab_terrain.solids import GROUND_DEPTH, Box, Floats, HeightField, Prism, Solid
from mjlab_terrain.surface import lowest_points
from mjlab_terrain.tile import Tile

FRICTION = (1.0, 0.005, 0.0001)
"""Sliding, torsional and rolling friction of ground by default [1, m, m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedTile:
  """Tile of a grid, and its place."""

  row: int
  column: int
  kind: int
  """Index of its type."""
  center: Floats
  """Of the tile, at the height of the rim, world frame, (3,) [m]."""
  tile: Tile
  lowest: float
  """Lowest height of its surface [m]."""
  lowest_at_rim: float
  """Lowest height of its surface along its rim [m]."""

  @property
  def origin(self) -> Floats:
    """Spawn point on the surface, world frame, (3,) [m]."""
    return self.center + np.array((*self.tile.spawn, self.tile.spawn_height()))


def place_tile(
  build: Callable[[Tile], None], label: str, tile: Tile, *, row: int, column: int, kind: int, center: Floats
) -> PlacedTile:
  """Build a tile; `label` is its type in messages.

  Raises:
    ValueError: `build` fails, or adds nothing.
  """
  try:
    build(tile)
  except ValueError as error:
    where = f"at difficulty {tile.difficulty:.3g}, tile ({row}, {column})"
    raise ValueError(f"{label}: {where}: {error}") from error
  if not tile.solids:
    raise ValueError(f"{label}: build added no geometry to the tile.")
  lowest, rim = lowest_points(tile.solids, tile.size)
  return PlacedTile(row=row, column=column, kind=kind, center=center, tile=tile, lowest=lowest, lowest_at_rim=rim)


def height_range(placed: Sequence[PlacedTile]) -> tuple[float, float]:
  """Return the lowest and highest point of the surface, with the ground around the tiles at 0 [m]."""
  highest = max(float(solid.high[2]) for p in placed for solid in p.tile.solids)
  return min(0.0, *(p.lowest for p in placed)), max(0.0, highest)


def gather(placed: Sequence[PlacedTile], border: Sequence[Box] = ()) -> list[tuple[Solid, int]]:
  """Return all solids in the world frame with their type; boxes that are level with each other become one.

  Where a pit reaches the rim of its tile, everything around it becomes deep enough to have no hollow below it.
  """
  rim = min((p.lowest_at_rim for p in placed), default=0.0)
  bottom = rim - GROUND_DEPTH if rim < 0.0 else np.inf
  solids = [
    ((solid.deepened(bottom) if solid.low[2] <= p.lowest else solid).moved(p.center), p.kind)
    for p in placed
    for solid in p.tile.solids
  ]
  solids += [(box.deepened(bottom), 0) for box in border]
  upright = [(s, kind) for s, kind in solids if isinstance(s, Box) and s.rotation is None]
  others = [(s, kind) for s, kind in solids if not (isinstance(s, Box) and s.rotation is None)]
  if not upright:
    return others
  low, high, kinds = merge_boxes(
    np.array([box.low for box, _ in upright]),
    np.array([box.high for box, _ in upright]),
    np.array([kind for _, kind in upright]),
  )
  merged = zip(0.5 * (low + high), 0.5 * (high - low), kinds.tolist(), strict=True)
  return [*((Box(center=center, half=half), kind) for center, half, kind in merged), *others]


def merge_boxes(low: Floats, high: Floats, kind: NDArray[np.int64]) -> tuple[Floats, Floats, NDArray[np.int64]]:
  """Join upright boxes of one kind that share a whole side and the same top and bottom, first along x, then along y.

  Args:
    low: Lowest corner of each box, (n, 3) [m].
    high: Highest corner of each box, (n, 3) [m].
    kind: Boxes of different kinds stay apart, (n,).

  Returns:
    The same three for the boxes that remain; together they fill the same space.
  """
  for axis in (0, 1):
    other = 1 - axis
    # Corners of neighbouring tiles agree but for rounding.
    keys = np.round(np.column_stack((low[:, other], high[:, other], low[:, 2], high[:, 2])) * 1e6).astype(np.int64)
    start, end = np.round(low[:, axis] * 1e6).astype(np.int64), np.round(high[:, axis] * 1e6).astype(np.int64)
    order = np.lexsort((start, *keys.T, kind))
    same = (keys[order][1:] == keys[order][:-1]).all(1) & (kind[order][1:] == kind[order][:-1])
    new_run = np.concatenate(([True], ~(same & (start[order][1:] == end[order][:-1]))))
    first = np.flatnonzero(new_run)
    last = np.concatenate((first[1:], [len(order)])) - 1
    merged = high[order][first]
    merged[:, axis] = high[order][last, axis]
    low, high, kind = low[order][first], merged, kind[order][first]
  return low, high, kind


def new_body(spec: mujoco.MjSpec, name: str, geom_names: Sequence[str]) -> mujoco.MjsBody:
  """Return a new static body, whose geoms will have these names.

  Raises:
    ValueError: the model already has an element of such a name; it is unchanged.
  """
  taken = next((f"geom named '{geom}'" for geom in geom_names if spec.geom(geom)), None)
  if spec.body(name):
    taken = f"body named '{name}'"
  if taken:
    again = "Give the terrain another name, or add it once."
    raise ValueError(f"terrain '{name}': the model '{spec.modelname}' already has a {taken}. {again}")
  return spec.worldbody.add_body(name=name)


def add_body(
  spec: mujoco.MjSpec,
  name: str,
  solids: Sequence[tuple[Solid, int]],
  coloring: Coloring,
  *,
  friction: tuple[float, float, float] = FRICTION,
  light: bool = True,
) -> tuple[str, ...]:
  """Add a static body with a geom for each solid, and return the names of the geoms.

  Raises:
    ValueError: the model already has a body or a geom of a name that is needed; it is unchanged.
  """
  names = tuple(f"{name}_{index}" for index in range(len(solids)))
  body = new_body(spec, name, names)
  for geom_name, (solid, kind) in zip(names, solids, strict=True):
    if isinstance(solid, Box):
      own = _box(solid)
    elif isinstance(solid, Prism):
      own = _prism(spec, geom_name, solid)
    else:
      own = _height_field(spec, geom_name, solid)
    if isinstance(solid, HeightField):
      _add_material(spec, geom_name, picture_of(solid, coloring, kind))
      own |= {"material": geom_name, "rgba": (1.0, 1.0, 1.0, 1.0)}
    else:
      own["rgba"] = (*coloring(kind, np.array(solid.color_height)), 1.0)
    # Explicit, although most are MuJoCo's defaults: the model may have defaults of its own.
    common: dict[str, Any] = {"condim": 3, "contype": 1, "conaffinity": 1, "group": 0, "mass": 0.0}
    body.add_geom(name=geom_name, friction=friction, **common, **own)
  if light:
    add_light(body, height=10.0, direction=(0.3, 0.2, -1.0))
  return names


def add_light(body: mujoco.MjsBody, *, height: float, direction: tuple[float, float, float]) -> None:
  """Add a directional light from above, named like the body."""
  body.add_light(
    name=body.name,
    type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    pos=(0.0, 0.0, height),
    dir=direction,
    diffuse=(0.6, 0.6, 0.6),
    castshadow=True,
  )


def _box(box: Box) -> dict[str, Any]:
  quat = np.array([1.0, 0.0, 0.0, 0.0])
  if box.rotation is not None:
    mujoco.mju_mat2Quat(quat, box.rotation.ravel())
  return {"type": mujoco.mjtGeom.mjGEOM_BOX, "pos": box.center, "quat": quat, "size": box.half}


def _prism(spec: mujoco.MjSpec, name: str, prism: Prism) -> dict[str, Any]:
  spec.add_mesh(name=name, uservert=(prism.corners - prism.center).ravel())
  return {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": name, "pos": prism.center}


def _height_field(spec: mujoco.MjSpec, name: str, field: HeightField) -> dict[str, Any]:
  low, high = field.heights.min(), field.heights.max()
  half = 0.5 * (field.high - field.low)
  nx, ny = field.heights.shape
  spec.add_hfield(
    name=name,
    nrow=ny,
    ncol=nx,
    size=(*half[:2], high - low, low - field.bottom),
    # MuJoCo counts rows along y.
    userdata=((field.heights - low) / (high - low)).T.ravel().tolist(),
  )
  middle = 0.5 * (field.low + field.high)
  return {"type": mujoco.mjtGeom.mjGEOM_HFIELD, "hfieldname": name, "pos": (*middle[:2], low)}


def _add_material(spec: mujoco.MjSpec, name: str, picture: bytes) -> None:
  spec.assets[f"{name}.png"] = picture
  texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=f"{name}.png")
  material = spec.add_material(name=name, specular=0.1, shininess=0.1)
  material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
