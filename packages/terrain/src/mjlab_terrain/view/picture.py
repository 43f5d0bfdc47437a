"""Pictures of a terrain, with OpenGL and without."""

from __future__ import annotations

import contextlib
import importlib
import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjlab_terrain.colors import coloring_of
from mjlab_terrain.grid import TerrainGridCfg
from mjlab_terrain.surface import surface
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
    cfg: Its light is left out.
    size: Width and height [pixels].
    azimuth: Direction of view, from x [deg].
    elevation: Direction of view, from the horizontal [deg].
    names: Write the name of its type above each tile.

  Raises:
    Exception: there is no OpenGL; the kind of the exception depends on the system.
  """
  model, extent = _stage(cfg, size)
  data = mujoco.MjData(model)
  mujoco.mj_forward(model, data)
  camera = mujoco.MjvCamera()
  camera.azimuth, camera.elevation = azimuth, elevation
  camera.distance = _distance(extent, size[0] / size[1], math.radians(azimuth), math.radians(elevation))
  camera.lookat[:] = (0.0, 0.0, -0.035 * camera.distance)
  width, height = size
  font = mujoco.mjtFontScale.mjFONTSCALE_200
  _load_triton()
  with mujoco.Renderer(model, height, width, max_geom=model.ngeom + 1000, font_scale=font) as renderer:
    renderer.update_scene(data, camera)
    if names:
      _add_names(renderer.scene, cfg)
    return renderer.render()


def _load_triton() -> None:
  # Software OpenGL and torch's compiler both bring an LLVM, and a Triton that is loaded after OpenGL's crashes.
  with contextlib.suppress(ImportError):
    importlib.import_module("triton._C.libtriton")


def _add_names(scene: mujoco.MjvScene, cfg: TerrainGridCfg) -> None:
  types = [name.replace("_", " ") for name in cfg.types]
  for tile in cfg.tiles()[: scene.maxgeom - scene.ngeom]:
    label = scene.geoms[scene.ngeom]
    place = tile.origin + np.array([0.0, 0.0, 0.4])
    mujoco.mjv_initGeom(label, mujoco.mjtGeom.mjGEOM_LABEL, np.zeros(3), place, np.eye(3).ravel(), np.ones(4))
    label.label = types[tile.kind]
    scene.ngeom += 1


def _stage(cfg: TerrainGridCfg, size: tuple[int, int]) -> tuple[mujoco.MjModel, tuple[float, float]]:
  """Return the terrain in two lights, of which the first casts shadows, and its extent along x and y [m]."""
  spec = mujoco.MjSpec()
  terrain = cfg.add_to(spec)
  for light in list(spec.lights):
    spec.delete(light)
  rows, columns = terrain.difficulty.shape
  extent = (
    rows * cfg.tile_size[0] + 2.0 * cfg.border_width,
    columns * cfg.tile_size[1] + 2.0 * cfg.border_width,
  )
  reach = 0.6 * math.hypot(*extent)
  spec.add_texture(
    name="sky",
    type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
    builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
    rgb1=np.array(PAPER) / 255.0,
    rgb2=np.array(PAPER) / 255.0,
    width=8,
    height=48,
  )
  sun, main, fill = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, np.array([-0.4, 0.3, -1.0]), np.array([0.7, -0.2, -0.6])
  # Shadows are sharpest when the light stands over what casts them.
  spec.worldbody.add_light(type=sun, pos=-reach * main, dir=main, diffuse=(0.62, 0.6, 0.56), specular=(0, 0, 0))
  spec.worldbody.add_light(
    type=sun, pos=-reach * fill, dir=fill, castshadow=False, diffuse=(0.16, 0.18, 0.2), specular=(0, 0, 0)
  )
  spec.visual.headlight.ambient = (0.38, 0.38, 0.4)
  spec.visual.headlight.diffuse = (0.1, 0.1, 0.1)
  spec.visual.headlight.specular = (0, 0, 0)
  spec.visual.quality.shadowsize = 8192
  spec.stat.extent, spec.stat.center = reach, (0, 0, 0)
  spec.visual.map.shadowclip = 1.0
  # No farther than needed: the depth of shadows shares the range.
  spec.visual.map.znear, spec.visual.map.zfar = 0.1, 10.0
  spec.visual.global_.offwidth, spec.visual.global_.offheight = size
  spec.visual.global_.fovy = _FOVY
  return spec.compile(), extent


def _distance(extent: tuple[float, float], aspect: float, azimuth: float, elevation: float) -> float:
  """Return the distance of a camera that sees all of the ground from the middle of it [m]."""
  x, y = 0.5 * extent[0], 0.5 * extent[1]
  across = abs(math.sin(azimuth)) * x + abs(math.cos(azimuth)) * y
  along = abs(math.cos(azimuth)) * x + abs(math.sin(azimuth)) * y
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
  coloring = coloring_of(cfg.color)
  for tile in tiles:
    row, column = tile.place * shape
    here = slice(row, row + shape[0]), slice(column, column + shape[1])
    heights[here] = surface(tile.solids, x, y)
    colors[here] = coloring(tile.kind, heights[here])
  # Light from the upper left, as on a map.
  slope = np.gradient(heights, x[1] - x[0], y[1] - y[0])
  shade = np.clip(1.0 - 0.35 * (slope[0] + slope[1]) / np.sqrt(1.0 + slope[0] ** 2 + slope[1] ** 2), 0.3, 1.3)
  pixels = np.round(255.0 * np.clip(colors * shade[..., None], 0.0, 1.0)).astype(np.uint8)[::-1, ::-1]
  return _with_names(pixels, list(cfg.types), tiles) if names else pixels


def _with_names(pixels: Pixels, types: list[str], tiles: list[Tile]) -> Pixels:
  """Return a map with the name of its type on each tile."""
  from PIL import Image, ImageDraw, ImageFont

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
