"""Pictures of the terrain, for the documentation: `MUJOCO_GL=egl uv run python tools/picture_terrain.py`.

Three pictures: a full grid, a sheet of every type at difficulty 0, 0.5 and 1, and ground from a mesh and a height map.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from mjlab_terrain import HeightMapCfg, MeshCfg, TerrainGridCfg, TileCfg, all_types
from mjlab_terrain.view.picture import PAPER, render
from PIL import Image, ImageDraw, ImageFont

GRID_SIZE = (1600, 600)
TILE_SIZE = (290, 246)
DIFFICULTIES = (0.0, 0.5, 1.0)
INK = (45, 52, 60)


def grid_picture() -> Image.Image:
  cfg = TerrainGridCfg(types=all_types(), rows=8, border_width=4.0, seed=1)
  return Image.fromarray(render(cfg, GRID_SIZE, elevation=-48.0))


def own_ground() -> dict[str, TileCfg]:
  """Return a mesh, a round temple on steps with four pillars, and a height map, a crater."""
  steps = [trimesh.creation.cylinder(3.4 - 0.3 * k, 0.16 * (k + 1), sections=48) for k in range(5)]
  for k, step in enumerate(steps):
    step.apply_translation((0.0, 0.0, 0.08 * (k + 1)))
  pillars = []
  for x, y in ((1.2, 1.2), (1.2, -1.2), (-1.2, 1.2), (-1.2, -1.2)):
    pillar = trimesh.creation.cylinder(0.25, 1.5)
    pillar.apply_translation((x, y, 0.75))
    pillars.append(pillar)
  temple: Any = trimesh.util.concatenate([*steps, *pillars])
  x, y = np.meshgrid(*2 * [np.linspace(-4.0, 4.0, 161)], indexing="ij")
  crater = 0.9 * np.exp(-4.0 * (np.hypot(x, y) - 2.2) ** 2) + 0.12 * np.sin(3.0 * x) * np.cos(2.0 * y)
  return {
    "mesh": MeshCfg(source=(temple.vertices, temple.faces), height=(0.2, 1.0), resolution=0.04),
    "height_map": HeightMapCfg(source=crater, height=(0.2, 1.0), border=0.2, blend=0.8),
  }


def sheet(types: dict[str, TileCfg]) -> Image.Image:
  """Two columns of types, each with a row of pictures from easy to hard."""
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
  pictures = {
    "terrain_grid": grid_picture,
    "terrain_types": lambda: sheet(all_types()),
    "terrain_own": lambda: sheet(own_ground()),
  }
  parser.add_argument("--only", nargs="+", choices=list(pictures), default=list(pictures))
  args = parser.parse_args()
  args.out.mkdir(parents=True, exist_ok=True)
  for name, draw in pictures.items():
    if name not in args.only:
      continue
    image = draw()
    path = args.out / f"{name}.png"
    image.save(path, optimize=True)
    print(path)


if __name__ == "__main__":
  main()
