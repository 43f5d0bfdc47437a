"""`visualize-terrain`: a terrain in the browser, or in a picture."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from mjlab_terrain.grid import TerrainGridCfg
from mjlab_terrain.picture import plot, render
from mjlab_terrain.png import png
from mjlab_terrain.presets import all_types, walking_types
from mjlab_terrain.settings import apply_settings
from mjlab_terrain.tile_cfg import TileCfg

ALL, WALKING = "all", "walking"


def types_named(names: Sequence[str]) -> dict[str, TileCfg]:
  """Types of tile by name; "all" and "walking" are sets of them.

  Raises:
    ValueError: there is no type of a name.
  """
  known, chosen = all_types(), {}
  for name in names:
    if name in (ALL, WALKING):
      chosen |= all_types() if name == ALL else walking_types()
    elif name in known:
      chosen[name] = known[name]
    else:
      raise ValueError(f"there is no type '{name}'. There are {ALL}, {WALKING}, {', '.join(known)}.")
  return chosen


def grid_of(arguments: argparse.Namespace) -> TerrainGridCfg:
  """The terrain that the command line describes. Raises ValueError if there is no such terrain."""
  types = types_named(arguments.types or [WALKING])
  apply_settings(types, arguments.set)
  single = len(types) == 1 and arguments.difficulty is not None
  low, high = arguments.difficulty or (0.0, 1.0)
  cfg = TerrainGridCfg(
    types=types,
    tile_size=tuple(arguments.tile_size),
    rows=1 if single and low == high else arguments.rows,
    columns=arguments.columns,
    layout=arguments.layout,
    difficulty=(low, high),
    seed=arguments.seed,
    color=arguments.color,
    border_width=arguments.border,
  )
  cfg.check()
  return cfg


def difficulty(text: str) -> tuple[float, float]:
  """One number, or two with a comma: the easiest and the hardest."""
  parts = [float(part) for part in text.split(",")]
  if len(parts) > 2:
    raise ValueError
  return parts[0], parts[-1]


def parser() -> argparse.ArgumentParser:
  """The command line."""
  line = argparse.ArgumentParser(prog="visualize-terrain", description="Shows terrain in the browser, or in a picture.")
  line.add_argument(
    "types", nargs="*", metavar="TYPE", help=f"types of tile; default: {WALKING}. {ALL}, {', '.join(all_types())}"
  )
  line.add_argument("--difficulty", type=difficulty, metavar="D[,D]", help="one, or easiest and hardest; default: 0,1")
  line.add_argument("--seed", type=int, default=0)
  line.add_argument("--rows", type=int, default=5)
  line.add_argument("--columns", type=int)
  line.add_argument("--tile-size", type=float, nargs=2, default=(8.0, 8.0), metavar=("X", "Y"), help="[m]")
  line.add_argument("--border", type=float, default=1.0, help="width of the ground around the grid [m]; default: 1")
  line.add_argument("--layout", choices=("curriculum", "random"), default="curriculum")
  line.add_argument("--color", choices=("height", "type"), default="height")
  line.add_argument(
    "--set",
    action="append",
    default=[],
    metavar="[TYPE.]SETTING=VALUE",
    help="a setting of one type or of all that have it, for example stairs_up.step_height=0,0.3",
  )
  line.add_argument("--image", type=Path, metavar="FILE.png", help="write a picture instead of showing a page")
  line.add_argument("--image-size", type=int, nargs=2, default=(1600, 900), metavar=("WIDTH", "HEIGHT"))
  line.add_argument("--plot", action="store_true", help="with --image: a map of heights, which needs no OpenGL")
  line.add_argument("--port", type=int, default=8080, help="of the page; default: 8080")
  return line


def write_image(cfg: TerrainGridCfg, path: Path, size: tuple[int, int], only_plot: bool) -> str:
  """Writes a picture and says what it is: a rendering, or a plot if there is no OpenGL."""
  pixels, kind = None, "rendering"
  if not only_plot:
    try:
      pixels = render(cfg, size, azimuth=35.0 if cfg.rows == 1 and len(cfg.types) == 1 else 0.0)
    except Exception as error:  # What a missing OpenGL raises depends on the system.
      print(f"no OpenGL ({type(error).__name__}: {error}); plotting heights instead", file=sys.stderr)
  if pixels is None:
    pixels, kind = plot(cfg, size), "plot"
  path.parent.mkdir(parents=True, exist_ok=True)
  path.write_bytes(png(pixels))
  return kind


def main(argv: Sequence[str] | None = None) -> int:
  """Runs the command; returns its exit code."""
  words = list(sys.argv[1:] if argv is None else argv)
  arguments = parser().parse_args(words)
  try:
    cfg = grid_of(arguments)
  except ValueError as error:
    print(f"visualize-terrain: {error}", file=sys.stderr)
    return 2
  if arguments.image is None:
    try:
      from mjlab_terrain.page import serve
    except ImportError:
      print(
        "visualize-terrain: the page needs viser: pip install 'mjlab-terrain[view]'. "
        "--image FILE.png works without it.",
        file=sys.stderr,
      )
      return 1
    serve(cfg, arguments.port)
    return 0
  if arguments.image.suffix.lower() != ".png":
    print(f"visualize-terrain: --image {arguments.image}: pictures are PNG; call it FILE.png", file=sys.stderr)
    return 2
  if min(arguments.image_size) < 1:
    width, height = arguments.image_size
    print(f"visualize-terrain: --image-size {width} {height}: both must be at least 1 pixel", file=sys.stderr)
    return 2
  # MuJoCo chooses how to render when it is imported, and without a display its first choice does not work.
  headless = sys.platform == "linux" and not os.environ.get("DISPLAY") and "MUJOCO_GL" not in os.environ
  if headless and not arguments.plot:
    command = [sys.executable, "-m", "mjlab_terrain.visualize", *words]
    run = subprocess.run(command, env={**os.environ, "MUJOCO_GL": "egl"}, capture_output=True, text=True)
    if run.returncode == 0:
      print(run.stdout, end="")
      return 0
  try:
    kind = write_image(cfg, arguments.image, tuple(arguments.image_size), arguments.plot or headless)
  except (ValueError, OSError) as error:
    print(f"visualize-terrain: {error}", file=sys.stderr)
    return 1
  print(f"{arguments.image} ({kind})")
  return 0


if __name__ == "__main__":
  sys.exit(main())
