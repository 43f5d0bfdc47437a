"""`visualize-terrain [TYPE ...] [flags]`: a terrain in the browser, or in a picture."""

import os
import sys
import textwrap
from ctypes.util import find_library
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from mjlab_core.constraints import Items, PositiveCount
from mjlab_core.names import check_name
from mjlab_viewer import check_address

from mjlab.cli.shared._command_line import CommandLine, PageArguments, as_usage, output_file, take
from mjlab.cli.shared._progress import imported

if TYPE_CHECKING:
  from mjlab_terrain import TerrainGridCfg, TileCfg


@dataclass(kw_only=True)
class Arguments(PageArguments):
  """All that can be given after the types."""

  difficulty: Annotated[tuple[float, ...], Items(ge=1, le=2)] = (0.0, 1.0)
  """Easiest and hardest difficulty, or one for all tiles, from 0 to 1."""
  seed: int = 0
  """Seed of the terrain."""
  rows: int = 5
  """Number of tiles along x, from easy to hard."""
  columns: int | None = None
  """Number of tiles along y; None: as the types need."""
  tile_size: tuple[float, float] = (8.0, 8.0)
  """Size of a tile along x and y [m]."""
  border: float = 1.0
  """Width of the ground around the grid [m]."""
  layout: Literal["curriculum", "random"] = "curriculum"
  """Order of the tiles: types by column and difficulty by row, or random."""
  color: Literal["height", "type"] = "height"
  """Meaning of the colors."""
  set: tuple[str, ...] = ()
  """Settings [TYPE.]SETTING=VALUE of one type or of all that have it, e.g. stairs_up.step_height=0,0.3."""
  image: str | None = None
  """Picture to write instead of showing a page: FILE.png."""
  image_size: tuple[PositiveCount, PositiveCount] = (1600, 900)
  """Width and height of the picture [px]."""
  plot: bool = False
  """Draw a map of heights instead of rendering; it needs no OpenGL."""


def run(words: list[str]) -> int:
  """Show terrain; return the exit code."""
  # MuJoCo chooses how to render when it is imported, and without a display its first choice does not work.
  if sys.platform == "linux" and not os.environ.get("DISPLAY") and find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")
  from mjlab_terrain import all_types

  types = textwrap.fill(f"types (default: walking): all, walking, {', '.join(all_types())}", 120)
  # All --set count, unlike other flags, whose last one counts.
  settings, words = take(words, "--set", nargs="*", action="extend")
  words += ["--set", *settings] if settings else []
  form = CommandLine("visualize-terrain", "[TYPE ...]", Arguments, notes=f"{types}\n")
  return form(_show)(words)


def _show(wanted: Arguments, names: list[str]) -> int:
  """Show terrain in the browser, or in a picture."""
  cfg = _grid(names, wanted)
  if wanted.image is not None:
    return _write_image(cfg, wanted)
  page = imported("mjlab_terrain.view.page")
  check_address(wanted.host, wanted.port)
  page.serve(cfg, wanted.port, wanted.host)
  return 0


def _grid(names: list[str], wanted: Arguments) -> "TerrainGridCfg":
  from mjlab_terrain import TerrainGridCfg
  from mjlab_terrain.presets import apply_settings

  low, high = wanted.difficulty[0], wanted.difficulty[-1]
  with as_usage():
    types = _types(names or ["walking"])
    apply_settings(types, wanted.set)
    cfg = TerrainGridCfg(
      types=types,
      rows=1 if len(types) == 1 and low == high else wanted.rows,
      difficulty=(low, high),
      border_width=wanted.border,
      **{name: getattr(wanted, name) for name in ("tile_size", "columns", "layout", "seed", "color")},
    )
    cfg.check()
    return cfg


def _types(names: list[str]) -> "dict[str, TileCfg]":
  """Return types of tile by name; "all" and "walking" are sets of them."""
  from mjlab_terrain import all_types, walking_types

  sets = {"all": all_types(), "walking": walking_types()}
  sets |= {name: {name: cfg} for name, cfg in all_types().items()}
  chosen: dict[str, TileCfg] = {}
  for name in names:
    chosen |= sets[check_name("type", name, sets)]
  return chosen


def _write_image(cfg: "TerrainGridCfg", wanted: Arguments) -> int:
  """Write a picture: a rendering, or a plot if that is wanted or OpenGL does not work."""
  path = output_file("--image", wanted.image or "", ".png", force=True)
  from mjlab_terrain.view.picture import plot, render
  from PIL import Image

  pixels, kind = None, "rendering"
  if not wanted.plot:
    try:
      pixels = render(
        cfg, wanted.image_size, azimuth=35.0 if cfg.rows == 1 and len(cfg.types) == 1 else 0.0, names=True
      )
    except Exception as error:  # The class of the error depends on the system.
      print(f"no OpenGL ({type(error).__name__}: {error}); plotting heights instead", file=sys.stderr)
  if pixels is None:
    pixels, kind = plot(cfg, wanted.image_size, names=True), "plot"
  path.parent.mkdir(parents=True, exist_ok=True)
  Image.fromarray(pixels).save(path)
  print(f"{path} ({kind})")
  return 0
