"""Tiles as geoms of an `MjSpec`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.merging import merge_boxes
from mjlab_terrain.png import png
from mjlab_terrain.tile import GROUND_DEPTH, Box, HeightField, Tile

# Edge of the picture that colors a height field [pixels].
_PICTURE = 96

Coloring = Callable[[int, NDArray[np.float64]], NDArray[np.float64]]
"""Color of ground of a type at heights (...), (..., 3) in [0, 1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedTile:
  """A tile of a grid, and where it is."""

  row: int
  column: int
  kind: int
  """Index of its type."""
  center: NDArray[np.float64]
  """Of the tile, at the height of the rim, world frame, (3,) [m]."""
  tile: Tile


@dataclass(frozen=True, kw_only=True)
class Surface:
  """How the ground feels and looks."""

  friction: tuple[float, float, float]
  coloring: Coloring


def geom_name(terrain: str, index: int) -> str:
  """Name of a geom of a terrain, and of the assets that only it uses."""
  return f"{terrain}_{index}"


def gather(
  placed: Sequence[PlacedTile], border: Sequence[Box]
) -> tuple[list[tuple[Box, int]], list[tuple[HeightField, NDArray[np.float64], int]]]:
  """All boxes in the world frame, merged, and all height fields with their tile's centre, with their type."""
  boxes = [(box, p.kind, p.center) for p in placed for box in p.tile.boxes]
  boxes += [(box, 0, np.zeros(3)) for box in border]
  upright = [entry for entry in boxes if entry[0].rotation is None]
  out = [
    (Box(center=box.center + at, half=box.half, rotation=box.rotation), kind)
    for box, kind, at in boxes
    if box.rotation is not None
  ]
  if upright:
    low = np.array([box.center - box.half + at for box, _, at in upright])
    high = np.array([box.center + box.half + at for box, _, at in upright])
    low, high, kinds = merge_boxes(low, high, np.array([kind for _, kind, _ in upright]))
    halves = 0.5 * (high - low)
    out = [(Box(center=c, half=h), int(k)) for c, h, k in zip(0.5 * (low + high), halves, kinds, strict=True)] + out
  return out, [(field, p.center, p.kind) for p in placed for field in p.tile.fields]


def add_geoms(
  spec: mujoco.MjSpec,
  name: str,
  boxes: Sequence[tuple[Box, int]],
  fields: Sequence[tuple[HeightField, NDArray[np.float64], int]],
  look: Surface,
) -> tuple[str, ...]:
  """Adds a static body with a geom for each box and height field, and returns the geoms' names."""
  body = spec.worldbody.add_body(name=name)
  # Said although most are MuJoCo's defaults: the model may have defaults of its own.
  common = {
    "friction": look.friction,
    "condim": 3,
    "contype": 1,
    "conaffinity": 1,
    "group": 0,
    "mass": 0.0,
  }
  names = []
  for box, kind in boxes:
    names.append(geom_name(name, len(names)))
    quat = np.array([1.0, 0.0, 0.0, 0.0])
    if box.rotation is not None:
      mujoco.mju_mat2Quat(quat, box.rotation.ravel())
    top = box.center[2] + box.half[2]
    body.add_geom(
      name=names[-1],
      type=mujoco.mjtGeom.mjGEOM_BOX,
      pos=box.center,
      quat=quat,
      size=box.half,
      rgba=(*look.coloring(kind, np.array(top)), 1.0),
      **common,
    )
  for field, center, kind in fields:
    names.append(geom_name(name, len(names)))
    low, high = field.heights.min(), field.heights.max()
    half = 0.5 * (field.x[1] - field.x[0]), 0.5 * (field.y[1] - field.y[0])
    nx, ny = field.heights.shape
    # MuJoCo counts rows along y.
    data = ((field.heights - low) / (high - low)).T
    spec.add_hfield(
      name=names[-1],
      nrow=ny,
      ncol=nx,
      size=(*half, high - low, GROUND_DEPTH),
      userdata=data.ravel().tolist(),
    )
    _add_picture(spec, names[-1], field, look.coloring, kind)
    middle = 0.5 * (field.x[0] + field.x[1]), 0.5 * (field.y[0] + field.y[1])
    body.add_geom(
      name=names[-1],
      type=mujoco.mjtGeom.mjGEOM_HFIELD,
      hfieldname=names[-1],
      pos=center + np.array((*middle, low)),
      material=names[-1],
      rgba=(1.0, 1.0, 1.0, 1.0),
      **common,
    )
  return tuple(names)


def _add_picture(spec: mujoco.MjSpec, name: str, field: HeightField, coloring: Coloring, kind: int) -> None:
  """Adds a material that colors a height field by height."""
  nx, ny = (min(n, _PICTURE) for n in field.heights.shape)
  i, j = (
    np.round(np.linspace(0, n - 1, m)).astype(np.int64) for n, m in zip(field.heights.shape, (nx, ny), strict=True)
  )
  colors = coloring(kind, field.heights[np.ix_(i, j)])
  # A picture's first row is at the far end of y.
  pixels = np.round(255.0 * np.clip(colors, 0.0, 1.0)).astype(np.uint8).transpose(1, 0, 2)[::-1]
  # As a file among the model's assets, because MuJoCo writes no XML of pictures that are none.
  spec.assets[f"{name}.png"] = png(pixels)
  texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=f"{name}.png")
  material = spec.add_material(name=name, specular=0.1, shininess=0.1)
  material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
