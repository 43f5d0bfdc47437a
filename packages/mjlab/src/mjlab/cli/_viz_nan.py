"""`viz-nan FILE [flags]`: report on a NaN dump, with a check whether MuJoCo C diverges too."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import mjlab_viewer
from mjlab_core.constraints import Positive

from mjlab.cli.shared._command_line import CommandLine, PageArguments, output_file
from mjlab.cli.shared._watching import browse_replay

if TYPE_CHECKING:
  from mjlab_sim import NanDump


@dataclass(kw_only=True)
class Arguments(PageArguments):
  """All that can be given after the file."""

  show: Literal["recorded", "mujoco-c"] = "recorded"
  """Steps that viewer and film show: the stored ones, or those that MuJoCo C computes from the same states."""
  viewer: Literal["none", "browser"] = "none"
  """browser: play the steps in a browser, in a loop."""
  speed: Positive = 0.1
  """Simulated seconds per real second."""
  video: str | None = None
  """Film to write: FILE.mp4."""
  force: bool = False
  """Overwrite an existing film."""


@CommandLine("viz-nan", "FILE", Arguments)
def run(wanted: Arguments, files: list[str]) -> int:
  """Report for each environment in a NaN dump the first value that was not finite or beyond 1e10.

  Repeat the last steps in MuJoCo C from the states of the dump, and report whether MuJoCo C diverges too.
  """
  (file,) = files
  if wanted.video is not None:
    output_file("--video", wanted.video, ".mp4", force=wanted.force)
  from mjlab_sim import NanDump

  dump = NanDump.load(file)
  _report(file, dump)
  if wanted.video is None and wanted.viewer == "none":
    print(f"\nsee it: viz-nan {file} --viewer browser")
    return 0
  from mjlab.nan_replay import NanReplay

  replay = NanReplay(dump, in_mujoco_c=wanted.show == "mujoco-c")
  if wanted.video is not None:
    with mjlab_viewer.OffscreenRenderer(replay.sim.mj_model) as renderer:
      replay.film(wanted.video, renderer, speed=wanted.speed)
    print(f"film: {wanted.video}")
  if wanted.viewer == "browser":
    print()
    browse_replay(replay, wanted.speed, host=wanted.host, port=wanted.port, label=Path(file).name)
  return 0


def _report(path: str, dump: "NanDump") -> None:
  print(f"{path}: {dump.engine} engine, {dump.decimation} physics steps per environment step")
  for world in dump.worlds:
    replay = world.replay()
    print(f"\nworld {world.index}, environment step {world.env_step}, {world.num_steps} physics steps stored")
    print(f"  {world.describe_first()}")
    if replay.diverged_at is None:
      print(f"  MuJoCo C stays finite over these steps; its positions differ by {replay.error:.2g} at most")
    else:
      print(f"  MuJoCo C diverges too, in physics step {replay.diverged_at + 1} of {world.num_steps}")
    if world.model_fields:
      print(f"  the world had its own {', '.join(sorted(world.model_fields))}")
