"""Draws the terrain for the documentation: `MUJOCO_GL=egl uv run python tools/picture_terrain.py`.

Two pictures: a full grid, and a sheet of every type at difficulty 0, 0.5 and 1.
"""

import argparse
from pathlib import Path

from mjlab_terrain import TerrainGridCfg, all_types
from mjlab_terrain.view.picture import PAPER, render
from PIL import Image, ImageDraw, ImageFont

GRID_SIZE = (1600, 600)
TILE_SIZE = (290, 246)
DIFFICULTIES = (0.0, 0.5, 1.0)
INK = (45, 52, 60)


def grid_picture() -> Image.Image:
  cfg = TerrainGridCfg(types=all_types(), rows=8, border_width=4.0, seed=1)
  return Image.fromarray(render(cfg, GRID_SIZE, elevation=-48.0))


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
        seed=1,
      )
      tile = Image.fromarray(render(grid, TILE_SIZE, azimuth=35.0, elevation=-38.0))
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
