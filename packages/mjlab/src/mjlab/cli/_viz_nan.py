"""`viz-nan FILE [flags]`: what a NaN dump says, and whether MuJoCo C diverges from there too."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from mjlab.cli._config_flags import flags
from mjlab.cli._errors import UsageError

if TYPE_CHECKING:
  from mjlab_sim import NanDump

  from mjlab.nan_replay import NanReplay


@dataclasses.dataclass(kw_only=True)
class Arguments:
  """All that can be given after the file."""

  show: Literal["recorded", "mujoco-c"] = "recorded"
  """What viewer and film show: the stored steps, or what MuJoCo C makes of them."""
  viewer: Literal["none", "browser"] = "none"
  """browser: play the steps in a browser, again and again."""
  host: str = "127.0.0.1"
  """Address that the browser viewer listens on; 0.0.0.0 lets other machines in."""
  port: int = 8080
  """Port of the browser viewer."""
  speed: float = 0.1
  """Seconds of the worlds for each real one."""
  video: str | None = None
  """Film to write: FILE.mp4."""
  force: bool = False
  """Overwrite the film."""
  traceback: bool = False
  """Show where an error came from."""


_HELP = """\
usage: viz-nan FILE [flags]

Says of each world in a NaN dump what was first not finite or beyond 1e10, and runs its last steps anew in MuJoCo C from
the states of the dump, to tell whether it diverges there too.

flags:
"""


def run(arguments: list[str]) -> int:
  """Print a report on every world of the file, and show them where that is wanted."""
  if "-h" in arguments or "--help" in arguments:
    print(_HELP + "\n".join(f"  --{flag.name:<10} {flag.about} [{flag.value}]" for flag in flags(Arguments())))
    return 0
  if not arguments or arguments[0].startswith("-"):
    raise UsageError("the file comes first. usage: viz-nan FILE [flags]")
  from mjlab.cli._flag_parser import parse

  wanted = parse(Arguments(), arguments[1:])
  if not wanted.speed > 0:
    raise UsageError(f"--speed must be positive, got {wanted.speed:g}")
  if wanted.video is not None and Path(wanted.video).exists() and not wanted.force:
    raise UsageError(f"{wanted.video} exists; --force overwrites it")
  from mjlab_sim import NanDump

  dump = NanDump.load(arguments[0])
  _report(arguments[0], dump)
  if wanted.video is None and wanted.viewer == "none":
    print(f"\nsee it: viz-nan {arguments[0]} --viewer browser")
    return 0
  from mjlab.nan_replay import NanReplay

  replay = NanReplay(dump, in_mujoco_c=wanted.show == "mujoco-c")
  if wanted.video is not None:
    _film(replay, wanted)
  if wanted.viewer == "browser":
    _browse(replay, wanted, arguments[0])
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


def _film(replay: "NanReplay", wanted: Arguments) -> None:
  from mjlab_viewer import OffscreenRenderer

  assert wanted.video is not None
  with OffscreenRenderer(replay.sim.mj_model) as renderer:
    replay.film(wanted.video, renderer, speed=wanted.speed)
  print(f"film: {wanted.video}")


def _browse(replay: "NanReplay", wanted: Arguments, path: str) -> None:
  from mjlab_viewer import BrowserViewer, Playback, ZeroPolicy

  playback = Playback(replay, ZeroPolicy(replay.num_envs, 0, replay.sim.device))
  playback.speed = wanted.speed
  label = Path(path).name
  with BrowserViewer(replay, playback=playback, host=wanted.host, port=wanted.port, label=label) as viewer:
    print(f"\nopen {viewer.url} (Ctrl-C ends)", flush=True)
    try:
      viewer.run()
    except KeyboardInterrupt:
      print()
