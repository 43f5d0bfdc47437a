"""Tiles as one static body of an `MjSpec`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.colors import Coloring, picture_of
from mjlab_terrain.solids import GROUND_DEPTH, Box, Floats, HeightField, Solid
from mjlab_terrain.tile import Tile

FRICTION = (1.0, 0.005, 0.0001)
"""Sliding, torsional and rolling friction of ground by default [1, m, m]."""


def height_range(tiles: Sequence[Tile]) -> tuple[float, float]:
  """Return the lowest and highest point of the surface, with the ground around the tiles at 0 [m]."""
  highest = max(float(solid.high[2]) for tile in tiles for solid in tile.solids)
  return min(0.0, *(tile.lowest_points[0] for tile in tiles)), max(0.0, highest)


def gather(tiles: Sequence[Tile], border: Sequence[Solid] = ()) -> list[tuple[Solid, int]]:
  """Return all solids in the world frame with their type; boxes that are level with each other become one.

  Where a pit reaches the rim of its tile, everything around it becomes deep enough to have no hollow below it.
  """
  rim = min(tile.lowest_points[1] for tile in tiles)
  bottom = rim - GROUND_DEPTH if rim < 0.0 else np.inf
  solids = [(_deepened(solid, bottom), 0) for solid in border]
  for tile in tiles:
    for solid in tile.solids:
      lowered = _deepened(solid, bottom) if solid.bottom <= tile.lowest_points[0] else solid
      solids.append((lowered.moved(tile.center), tile.kind))
  plain = [(solid, kind) for solid, kind in solids if isinstance(solid, Box) and solid.is_plain]
  others = [(solid, kind) for solid, kind in solids if not (isinstance(solid, Box) and solid.is_plain)]
  if not plain:
    return others
  low, high = (np.array([getattr(box, end) for box, _ in plain]) for end in ("low", "high"))
  low, high, kinds = merge_boxes(low, high, np.array([kind for _, kind in plain]))
  center, half = np.column_stack((0.5 * (low + high)[:, :2], high[:, 2])), 0.5 * (high - low)[:, :2]
  merged = [Box(center=c, half=tuple(h), bottom=float(z)) for c, h, z in zip(center, half, low[:, 2], strict=True)]
  return [*zip(merged, kinds.tolist(), strict=True), *others]


def _deepened(solid: Solid, bottom: float) -> Solid:
  return replace(solid, bottom=min(solid.bottom, bottom))


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
    # Corners of neighbouring tiles agree but for rounding.
    ends = np.round(np.column_stack((low, high)) * 1e6).astype(np.int64)
    start, end = ends[:, axis], ends[:, 3 + axis]
    keys = np.column_stack((ends[:, [1 - axis, 4 - axis, 2, 5]], kind))
    order = np.lexsort((start, *keys.T))
    joins = (keys[order][1:] == keys[order][:-1]).all(1) & (start[order][1:] == end[order][:-1])
    first, last = order[np.append(True, ~joins)], order[np.append(~joins, True)]
    merged = high[first]
    merged[:, axis] = high[last, axis]
    low, high, kind = low[first], merged, kind[first]
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


def add_geom(body: mujoco.MjsBody, name: str, friction: tuple[float, float, float], **fields: Any) -> None:
  """Add a geom of group 0 that collides with everything, whatever the defaults of the model are."""
  body.add_geom(name=name, friction=friction, condim=3, contype=1, conaffinity=1, group=0, mass=0.0, **fields)


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
    if isinstance(solid, HeightField):
      _add_material(spec, geom_name, picture_of(solid, coloring, kind))
      look: dict[str, Any] = {"material": geom_name, "rgba": (1.0, 1.0, 1.0, 1.0)}
    else:
      look = {"rgba": (*coloring(kind, solid.center[2]), 1.0)}
    add_geom(body, geom_name, friction, **_shape(spec, geom_name, solid), **look)
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


def _shape(spec: mujoco.MjSpec, name: str, solid: Solid) -> dict[str, Any]:
  """Return the fields of a geom that give its shape, and add the asset of this name that it needs."""
  x, y, top = solid.center
  if isinstance(solid, HeightField):
    low, high = solid.top_range
    nx, ny = solid.heights.shape
    spec.add_hfield(
      name=name,
      nrow=ny,
      ncol=nx,
      size=(*solid.half, high - low, top + low - solid.bottom),
      # MuJoCo counts rows along y.
      userdata=((solid.heights - low) / (high - low)).T.ravel().tolist(),
    )
    return {"type": mujoco.mjtGeom.mjGEOM_HFIELD, "hfieldname": name, "pos": (x, y, top + low)}
  if any(solid.slope):
    spec.add_mesh(name=name, uservert=(solid.corners - solid.center).ravel())
    return {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": name, "pos": solid.center}
  return {
    "type": mujoco.mjtGeom.mjGEOM_BOX,
    "pos": (x, y, 0.5 * (solid.bottom + top)),
    "quat": (np.cos(0.5 * solid.yaw), 0.0, 0.0, np.sin(0.5 * solid.yaw)),
    "size": (*solid.half, 0.5 * (top - solid.bottom)),
  }


def _add_material(spec: mujoco.MjSpec, name: str, picture: bytes) -> None:
  spec.assets[f"{name}.png"] = picture
  texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=f"{name}.png")
  material = spec.add_material(name=name, specular=0.1, shininess=0.1)
  material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
