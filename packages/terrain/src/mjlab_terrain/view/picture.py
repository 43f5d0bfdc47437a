"""Pictures of a terrain, with OpenGL and without."""

from __future__ import annotations

import contextlib
import importlib
import math

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from mjlab_terrain.colors import as_pixels, color_of
from mjlab_terrain.grid import TerrainGridCfg
from mjlab_terrain.surface import surface
from mjlab_terrain.terrain import Terrain
from mjlab_terrain.tile import Tile

Pixels = NDArray[np.uint8]
"""Red, green and blue, first line at the top, (height, width, 3)."""

PAPER = (246, 247, 248)
"""Color around the terrain, red, green and blue in [0, 255]."""

_FOVY = 30.0


def render(
  cfg: TerrainGridCfg,
  size: tuple[int, int],
  *,
  azimuth: float = 0.0,
  elevation: float = -45.0,
  names: bool = False,
) -> Pixels:
  """Return a picture of the whole terrain under a pale sky, (height, width, 3).

  Args:
    cfg: The terrain.
    size: Width and height [pixels].
    azimuth: Direction of view, from x [deg].
    elevation: Direction of view, from the horizontal [deg].
    names: Write the name of its type above each tile.

  Raises:
    Exception: there is no OpenGL; the kind of the exception depends on the system.
  """
  spec = mujoco.MjSpec()
  terrain = cfg.add_to(spec)
  extent = np.multiply(terrain.difficulty.shape, cfg.tile_size) + 2.0 * cfg.border_width
  paper, builtin = np.array(PAPER) / 255.0, mujoco.mjtBuiltin.mjBUILTIN_FLAT
  sky = mujoco.mjtTexture.mjTEXTURE_SKYBOX
  spec.add_texture(name="sky", type=sky, builtin=builtin, rgb1=paper, rgb2=paper, width=8, height=48)
  width, height = spec.visual.global_.offwidth, spec.visual.global_.offheight = size
  spec.visual.global_.fovy, spec.visual.quality.shadowsize = _FOVY, 8192
  spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.4] * 3, [0.1] * 3
  model = spec.compile()
  data = mujoco.MjData(model)
  mujoco.mj_forward(model, data)
  camera = mujoco.MjvCamera()
  camera.azimuth, camera.elevation = azimuth, elevation
  camera.distance = _distance(extent, width / height, math.radians(azimuth), math.radians(elevation))
  camera.lookat[:] = (0.0, 0.0, -0.035 * camera.distance)
  font = mujoco.mjtFontScale.mjFONTSCALE_200
  _load_triton()
  with mujoco.Renderer(model, height, width, max_geom=model.ngeom + 1000, font_scale=font) as renderer:
    renderer.update_scene(data, camera)
    if names:
      _add_names(renderer.scene, terrain)
    return renderer.render()


def _load_triton() -> None:
  # Software OpenGL and torch's compiler both bring an LLVM, and a Triton that is loaded after OpenGL's crashes.
  with contextlib.suppress(ImportError):
    importlib.import_module("triton")


def _add_names(scene: mujoco.MjvScene, terrain: Terrain) -> None:
  label, turn, white = mujoco.mjtGeom.mjGEOM_LABEL, np.eye(3).ravel(), np.ones(4)
  names = [terrain.type_names[kind].replace("_", " ") for kind in terrain.tile_types.ravel()]
  places = terrain.origins.reshape(-1, 3) + np.array([0.0, 0.0, 0.4])
  for name, place in list(zip(names, places, strict=True))[: scene.maxgeom - scene.ngeom]:
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, label, np.zeros(3), place, turn, white)
    geom.label = name
    scene.ngeom += 1


def _distance(extent: NDArray[np.float64], aspect: float, azimuth: float, elevation: float) -> float:
  """Return the distance of a camera that sees all of the ground from the middle of it [m]."""
  cos, sin = abs(math.cos(azimuth)), abs(math.sin(azimuth))
  across, along = 0.5 * np.array(((sin, cos), (cos, sin))) @ extent
  slope = math.tan(math.radians(0.5 * _FOVY))
  needed = max(across / aspect, along * abs(math.sin(elevation)) + 1.0) / slope
  return 1.12 * needed + 0.8 * along * math.cos(elevation)


def plot(cfg: TerrainGridCfg, size: tuple[int, int], *, names: bool = False) -> Pixels:
  """Return a map of heights, shaded by slope, x up and y to the left, at most `size` pixels, (height, width, 3).

  With `names`, each tile has the name of its type.
  """
  tiles = cfg.tiles()
  grid = np.add(tiles[-1].place, 1)
  scale = min(np.array(size[::-1]) / (grid * cfg.tile_size))
  shape = np.maximum(np.multiply(cfg.tile_size, scale).astype(int), 2)
  x, y = (s * ((np.arange(n) + 0.5) / n - 0.5) for s, n in zip(cfg.tile_size, shape, strict=True))
  heights = np.zeros(grid * shape)
  colors = np.zeros((*heights.shape, 3))
  for tile in tiles:
    row, column = tile.place * shape
    here = slice(row, row + shape[0]), slice(column, column + shape[1])
    heights[here] = surface(tile.solids, x, y)
    colors[here] = color_of(cfg.color, tile.kind, heights[here])
  # Light from the upper left, as on a map.
  slope = np.gradient(heights, x[1] - x[0], y[1] - y[0])
  shade = np.clip(1.0 - 0.35 * (slope[0] + slope[1]) / np.sqrt(1.0 + slope[0] ** 2 + slope[1] ** 2), 0.3, 1.3)
  pixels = as_pixels(colors * shade[..., None])[::-1, ::-1]
  return _with_names(pixels, list(cfg.types), tiles) if names else pixels


def _with_names(pixels: Pixels, types: list[str], tiles: list[Tile]) -> Pixels:
  """Return a map with the name of its type on each tile."""
  image = Image.fromarray(np.ascontiguousarray(pixels))
  draw = ImageDraw.Draw(image)
  edges = np.array(image.size[::-1]) / np.add(tiles[-1].place, 1)
  font = ImageFont.load_default(size=max(8.0, 0.12 * min(edges)))
  for tile in tiles:
    # x points up and y to the left.
    up, left = image.size[::-1] - np.add(tile.place, 0.5) * edges
    name = types[tile.kind].replace("_", "\n")
    draw.text((left, up), name, font=font, fill="white", stroke_width=2, stroke_fill="black", anchor="mm")
  return np.asarray(image)
