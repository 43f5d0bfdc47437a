"""Tiles as one static body of an `MjSpec`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from mjlab_terrain.colors import GroundColor, color_of, picture_of
from mjlab_terrain.solids import GROUND_DEPTH, HeightField, Solid, box_between
from mjlab_terrain.terrain import Terrain
from mjlab_terrain.tile import Tile

FRICTION = (1.0, 0.005, 0.0001)
"""Sliding, torsional and rolling friction of ground by default [1, m, m]."""


def add_tiles(
  spec: mujoco.MjSpec,
  name: str,
  tiles: Sequence[Tile],
  border: Sequence[Solid] = (),
  *,
  color: GroundColor = "height",
  friction: tuple[float, float, float] = FRICTION,
  light: bool = True,
  **described: Any,
) -> Terrain:
  """Add a static body with all tiles to the world of `spec`.

  Args:
    spec: Model to add to.
    name: Name of the body.
    tiles: Tiles of a whole grid, row by row.
    border: Ground around them.
    color: Meaning of the color.
    friction: Friction of all geoms.
    light: True adds a light.
    described: Other fields of the terrain.

  Raises:
    ValueError: the model already has a body or a geom of a name that is needed; it is unchanged.
  """
  solids = gather(tiles, border)
  names = tuple(f"{name}_{index}" for index in range(len(solids)))
  body = new_body(spec, name, names)
  for geom_name, solid in zip(names, solids, strict=True):
    rgba = color_of(color, solid.kind, np.array(solid.center[2]))
    if isinstance(solid, HeightField):
      _add_material(spec, geom_name, picture_of(solid, color))
      rgba = np.ones(3)
    add_geom(body, geom_name, friction, rgba=(*rgba, 1.0), **_shape(spec, geom_name, solid))
  if light:
    add_light(body, height=10.0, direction=(0.3, 0.2, -1.0))
  rows, columns = np.add(tiles[-1].place, 1)
  highest = max(float(solid.high[2]) for tile in tiles for solid in tile.solids)
  return Terrain(
    name=name,
    geom_names=names,
    tile_size=tiles[0].size,
    origins=np.reshape([tile.origin for tile in tiles], (rows, columns, 3)),
    difficulty=np.reshape([tile.difficulty for tile in tiles], (rows, columns)),
    tile_types=np.reshape([tile.kind for tile in tiles], (rows, columns)),
    height_range=(min(0.0, *(tile.lowest_points[0] for tile in tiles)), max(0.0, highest)),
    **described,
  )


def gather(tiles: Sequence[Tile], border: Sequence[Solid] = ()) -> list[Solid]:
  """Return all solids in the world frame; boxes that are level with each other become one.

  If a pit reaches the rim of its tile, the ground around it becomes deeper, so that it has no hollow below it.
  """
  rim = min(tile.lowest_points[1] for tile in tiles)
  bottom = rim - GROUND_DEPTH if rim < 0.0 else np.inf
  solids = [replace(solid, bottom=min(solid.bottom, bottom)) for solid in border]
  for tile in tiles:
    for solid in tile.solids:
      depth = min(solid.bottom, bottom) if solid.bottom <= tile.lowest_points[0] else solid.bottom
      solids.append(replace(solid, center=solid.center + tile.center, bottom=depth))
  plain = merge_boxes([solid for solid in solids if solid.is_plain])
  return [*plain, *(solid for solid in solids if not solid.is_plain)]


def merge_boxes(boxes: Sequence[Solid]) -> Sequence[Solid]:
  """Join plain boxes of one type that share a whole side and the same top and bottom, first along x, then along y."""
  for axis in (0, 1):
    merged: dict[tuple[int, ...], Solid] = {}
    for box in sorted(boxes, key=lambda box: box.low[axis]):
      # Corners of neighbouring tiles agree but for rounding.
      low, high = ([round(1e6 * at) for at in corner.tolist()] for corner in (box.low, box.high))
      start, end = low.pop(axis), high.pop(axis)
      # Keys have the end of a box, to be found by the box that starts there.
      before = merged.pop((start, box.kind, *low, *high), box)
      joined = box_between(*zip(before.low, box.high, strict=True), kind=box.kind)
      merged.setdefault((end, box.kind, *low, *high), joined)
    boxes = list(merged.values())
  return boxes


def new_body(spec: mujoco.MjSpec, name: str, geom_names: Sequence[str]) -> mujoco.MjsBody:
  """Return a new static body for geoms of these names.

  Raises:
    ValueError: the model already has an element of such a name; it is unchanged.
  """
  taken = [f"body named '{name}'"] if spec.body(name) else []
  taken += [f"geom named '{geom}'" for geom in geom_names if spec.geom(geom)]
  if taken:
    again = "Give the terrain another name, or add it once."
    raise ValueError(f"terrain '{name}': the model '{spec.modelname}' already has a {taken[0]}. {again}")
  return spec.worldbody.add_body(name=name)


def add_geom(body: mujoco.MjsBody, name: str, friction: tuple[float, float, float], **fields: Any) -> None:
  """Add a geom of group 0 that collides with all geoms, independent of the defaults of the model."""
  body.add_geom(name=name, friction=friction, condim=3, contype=1, conaffinity=1, group=0, mass=0.0, **fields)


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
    return {"type": mujoco.mjtGeom.mjGEOM_HFIELD, "hfieldname": name, "material": name, "pos": (x, y, top + low)}
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
