"""Draws the terrain for the documentation: `MUJOCO_GL=egl uv run python tools/picture_terrain.py`.

Two pictures: a full grid, and a sheet of every type at difficulty 0, 0.5 and 1.
"""

import argparse
from pathlib import Path

import mujoco
import numpy as np
from mjlab_terrain import TerrainGridCfg, all_types
from PIL import Image, ImageDraw, ImageFont

GRID_SIZE = (1600, 600)
TILE_SIZE = (290, 228)
DIFFICULTIES = (0.0, 0.5, 1.0)
# Rendered larger and averaged: smoother edges than the renderer's own multisampling.
OVERSAMPLING = 2
INK = (45, 52, 60)
PAPER = (246, 247, 248)


def stage(cfg: TerrainGridCfg, size: tuple[int, int], shadow: float) -> mujoco.MjModel:
  """The terrain under a pale sky, in two lights; only the first casts shadows, of things within `shadow` [m]."""
  spec = mujoco.MjSpec()
  cfg.add_to(spec)
  spec.add_texture(
    name="sky",
    type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
    builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
    rgb1=np.array(PAPER) / 255.0,
    rgb2=np.array(PAPER) / 255.0,
    width=8,
    height=48,
  )
  sun = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
  main, fill = np.array([-0.4, 0.3, -1.0]), np.array([0.7, -0.2, -0.6])
  # Shadows are sharpest when the light stands over what casts them.
  spec.worldbody.add_light(type=sun, pos=-shadow * main, dir=main, diffuse=[0.62, 0.6, 0.56], specular=[0, 0, 0])
  spec.worldbody.add_light(
    type=sun, pos=-shadow * fill, dir=fill, castshadow=False, diffuse=[0.16, 0.18, 0.2], specular=[0, 0, 0]
  )
  spec.visual.headlight.ambient = [0.38, 0.38, 0.4]
  spec.visual.headlight.diffuse = [0.1, 0.1, 0.1]
  spec.visual.headlight.specular = [0, 0, 0]
  spec.visual.quality.shadowsize = 8192
  spec.stat.extent, spec.stat.center = shadow, [0, 0, 0]
  spec.visual.map.shadowclip = 1.0
  # No farther than needed: the depth of shadows shares the range.
  spec.visual.map.znear, spec.visual.map.zfar = 0.2, 6.0
  spec.visual.global_.offwidth, spec.visual.global_.offheight = (OVERSAMPLING * s for s in size)
  spec.visual.global_.fovy = 30.0
  return spec.compile()


def picture(
  model: mujoco.MjModel, size: tuple[int, int], distance: float, azimuth: float, elevation: float, down: float = 0.0
) -> Image.Image:
  data = mujoco.MjData(model)
  mujoco.mj_forward(model, data)
  camera = mujoco.MjvCamera()
  camera.lookat[:] = (0.0, 0.0, -down)
  camera.distance, camera.azimuth, camera.elevation = distance, azimuth, elevation
  with mujoco.Renderer(model, size[1] * OVERSAMPLING, size[0] * OVERSAMPLING, max_geom=50_000) as renderer:
    renderer.update_scene(data, camera)
    pixels = renderer.render()
  return Image.fromarray(np.asarray(pixels)).resize(size, Image.Resampling.LANCZOS)


def grid_picture() -> Image.Image:
  cfg = TerrainGridCfg(types=all_types(), rows=8, border_width=4.0, light=False, seed=1)
  return picture(stage(cfg, GRID_SIZE, 80.0), GRID_SIZE, 132.0, 0.0, -48.0, down=3.0)


def sheet() -> Image.Image:
  """Two columns of types, each with a row of pictures from easy to hard."""
  types = all_types()
  per_column, label, margin = -(-len(types) // 2), 118, 14
  width, height = (label + len(DIFFICULTIES) * TILE_SIZE[0] + margin), TILE_SIZE[1]
  page = Image.new("RGB", (2 * width, per_column * height + 40), PAPER)
  draw = ImageDraw.Draw(page)
  font = ImageFont.load_default(size=17)
  for k, (name, cfg) in enumerate(types.items()):
    x, y = (k // per_column) * width, (k % per_column) * height + 40
    draw.multiline_text((x + margin, y + height / 2), name.replace("_", "\n"), font=font, fill=INK, anchor="lm")
    for d, difficulty in enumerate(DIFFICULTIES):
      if k % per_column == 0:
        middle = x + label + (d + 0.5) * TILE_SIZE[0]
        draw.text((middle, 22), f"difficulty {difficulty:g}", font=font, fill=INK, anchor="mm")
      grid = TerrainGridCfg(
        types={name: cfg},
        rows=1,
        columns=1,
        difficulty=(difficulty, difficulty),
        border_width=0.0,
        light=False,
        seed=1,
      )
      tile = picture(stage(grid, TILE_SIZE, 8.0), TILE_SIZE, 19.5, 35.0, -38.0, down=1.35)
      page.paste(tile, (x + label + d * TILE_SIZE[0], y))
  return page


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "pictures")
  args = parser.parse_args()
  args.out.mkdir(parents=True, exist_ok=True)
  for name, image in (("terrain_grid", grid_picture()), ("terrain_types", sheet())):
    path = args.out / f"{name}.png"
    image.save(path, optimize=True)
    print(path)


if __name__ == "__main__":
  main()
