"""`convert-motion CLIP ... [flags]`: check motion clips and convert them."""

import contextlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import mjlab_motions
import mjlab_viewer
from mjlab_core import UsageError, safe_name
from mjlab_core.io.files import reading
from mjlab_core.names import check_name
from mjlab_motions import shipped_clips
from mjlab_motions.clips import read_json, read_text

from mjlab.cli.shared._command_line import CommandLine, PageArguments, as_usage, output_file
from mjlab.cli.shared._progress import progress_bar
from mjlab.cli.shared._watching import browse_replay

if TYPE_CHECKING:
  import mujoco


@dataclass(kw_only=True)
class Arguments(PageArguments):
  """All that can be given after the clips."""

  robot: str = "g1"
  """Robot: g1, go1, or the path of an MJCF."""
  rate: float | None = None
  """Fact that the file lacks: frames per second [Hz]."""
  quaternion: Literal["wxyz", "xyzw"] | None = None
  """Fact that the file lacks: order of quaternions; None: proven, or refused."""
  joint_names: str | None = None
  """Fact that the file lacks: names of the joint columns, as a,b,c or in a text file."""
  body_names: str | None = None
  """Fact that the file lacks: names of the bodies of a seven-key .npz, likewise."""
  joint_map: str | None = None
  """JSON file: {"robot joint": "column" or a constant angle, ...}."""
  crop: tuple[float, float] | None = None
  """Edit 1: keep the part between two times [s]."""
  output_rate: float | None = None
  """Edit 2: resample [Hz]. Training resamples itself."""
  mirror: bool = False
  """Edit 3: exchange left and right."""
  concatenate: float | None = None
  """Edit 4: join the clips, blended over this time [s]."""
  smooth: float | None = None
  """Edit 5: smooth with a Gaussian of this standard deviation [s]."""
  ground: bool = False
  """Edit 6: shift the clip vertically until the feet are on the ground."""
  output: str | None = None
  """Motion file to write, an .npz; for several clips a folder."""
  report: str | None = None
  """Picture of the report, a .png; for several clips a folder."""
  video: str | None = None
  """Film of the clip, an .mp4; for several clips a folder."""
  source: str | None = None
  """Origin of the clip, stored in the motion file."""
  license: str | None = None
  """Terms of the clip, e.g. CC-BY-4.0, stored in the motion file."""
  compact: bool = False
  """Write root and joints only, without arrays that follow from them."""
  accept_errors: bool = False
  """Write despite errors in the report."""
  force: bool = False
  """Replace existing files."""
  preview: bool = False
  """Then play the clip in a browser."""


@CommandLine(
  "convert-motion",
  "CLIP [MORE ...]",
  Arguments,
  notes="""\
exit codes: 0 written, or only reported; 1 a clip cannot be read or has errors, and is not written; 2 wrong command line

examples:
  convert-motion dance.csv --rate 60 --ground --output dance.npz --report dance.png
  convert-motion walk.npz                                    a report, nothing written
  convert-motion march_in_place --preview                    a clip that ships, in a browser
  convert-motion clips/*.csv --rate 30 --output library/     a folder of clips
  convert-motion a.csv --rate 30 --robot my_robot.xml --joint-map map.json --output a.npz
""",
)
def run(wanted: Arguments, clips: list[str]) -> int:
  """Read clips (.csv, .npz, or the name of a clip that ships), edit them, report on them, and write them."""
  from mjlab.cli.shared._clip_preview import clip_replay, film_clip, preview_model

  spec = robot_spec(wanted.robot)
  robot = mjlab_motions.Kinematics(spec.compile())
  motions = _read(clips, robot, wanted)
  if wanted.preview and len(motions) > 1:
    raise UsageError(f"--preview shows one clip, not {len(motions)}; --concatenate joins them")
  endings = {"output": ".npz", "report": ".png", "video": ".mp4"}
  files = [_targets(flag, motions, ending, wanted) for flag, ending in endings.items()]
  model: Any = preview_model(spec) if wanted.preview or wanted.video is not None else None
  has_errors = False
  with contextlib.ExitStack() as opened:
    renderer: Any = None
    if wanted.video is not None:
      # Opened before anything is written: without OpenGL no part of the work is done.
      renderer = opened.enter_context(mjlab_viewer.OffscreenRenderer(model))
    show = opened.enter_context(progress_bar("converting", len(motions)))
    for index, (motion, target, picture, film) in enumerate(zip(motions, *files, strict=True)):
      show(index, motion.name)
      has_errors |= not _write(motion, robot, target, picture, wanted)
      if film is not None:
        replay = clip_replay(model, motion)
        film_clip(replay, motion.rate, film, renderer, lambda share, done=index: show(done + share, "filming"))
        print(f"filmed {film}")
      print()
  if wanted.preview:
    browse_replay(clip_replay(model, motions[0]), host=wanted.host, port=wanted.port, label=motions[0].name)
  return int(has_errors)


def _read(clips: list[str], robot: "mjlab_motions.Kinematics", wanted: Arguments) -> "list[mjlab_motions.Motion]":
  """Return the edited clips."""
  example = '{"robot joint": "column" or a number, ...}'
  stated_facts = mjlab_motions.Statement(
    rate=wanted.rate,
    quaternion=wanted.quaternion,
    joint_names=_names(wanted.joint_names),
    body_names=_names(wanted.body_names),
    joint_map=None if wanted.joint_map is None else read_json(wanted.joint_map, dict[str, str | float], example),
  )
  stated = {name: text for name in ("source", "license") if (text := getattr(wanted, name)) is not None}
  motions: list[mjlab_motions.Motion] = []
  with progress_bar("reading", len(clips)) as show:
    for clip in clips:
      motions.append(mjlab_motions.read_motion(_found(clip), robot, stated_facts))
      show(len(motions), motions[-1].name)
  with as_usage():
    if wanted.crop is not None:
      motions = [mjlab_motions.crop(motion, *wanted.crop) for motion in motions]
    if wanted.output_rate is not None:
      motions = [mjlab_motions.resample(motion, wanted.output_rate) for motion in motions]
    if wanted.mirror:
      motions = [mjlab_motions.mirror(motion, robot) for motion in motions]
    if wanted.concatenate is not None:
      motions = [mjlab_motions.concatenate(motions, blend=wanted.concatenate)]
    if wanted.smooth is not None:
      motions = [mjlab_motions.smooth(motion, wanted.smooth) for motion in motions]
    if wanted.ground:
      motions = [mjlab_motions.to_ground(motion, robot) for motion in motions]
  if stated:
    motions = [motion.changed(f"{' and '.join(stated)} stated", **stated) for motion in motions]
  return motions


def _write(
  motion: "mjlab_motions.Motion",
  robot: "mjlab_motions.Kinematics",
  target: Path | None,
  picture: Path | None,
  wanted: Arguments,
) -> bool:
  """Report on a clip and write it; return False if errors forbid that."""
  report = mjlab_motions.check_quality(motion, robot)
  print(report.table())
  if picture is not None:
    mjlab_motions.plot_quality(report, picture)
    print(f"drew {picture}")
  is_good = report.severity != "error" or wanted.accept_errors
  if target is not None and is_good:
    mjlab_motions.save_motion(motion, target, None if wanted.compact else mjlab_motions.derived_arrays(motion, robot))
    print(f"wrote {target}: {motion.num_frames} frames at {motion.rate:g} Hz")
  elif target is not None:
    print(f"not written: {target}, because of the errors above; --accept-errors writes it", file=sys.stderr)
  return is_good


def robot_spec(name: str) -> "mujoco.MjSpec":
  """Return a robot by name (g1, go1) or by the path of its MJCF.

  Raises:
    UnknownNameError: There is no such robot.
    FileError: The file is not an MJCF.
  """
  import mujoco
  from mjlab_robots import g1_spec, go1_spec

  specs = {"g1": g1_spec, "go1": go1_spec}
  if name in specs:
    return specs[name](meshes="never")
  if not Path(name).is_file():
    check_name("robot", name, specs, "--robot (a name, or the path of an .xml)")
  with reading("robot", name):
    spec = mujoco.MjSpec.from_file(name)
    spec.compile()
  return spec


def _names(text: str | None) -> tuple[str, ...] | None:
  """Return names given as a,b,c or in a text file."""
  if text is None:
    return None
  words = read_text(text).replace(",", " ").split() if Path(text).is_file() else text.split(",")
  return tuple(word.strip() for word in words if word.strip())


def _found(clip: str) -> Path:
  """Return the file of a clip: this one, or that of a clip that ships."""
  path, shipped = Path(clip), shipped_clips()
  return path if path.is_file() or path.suffix else shipped[check_name("clip", clip, shipped)]


def _targets(flag: str, motions: "Sequence[mjlab_motions.Motion]", ending: str, wanted: Arguments) -> list[Path | None]:
  """Return the file that a flag names for each motion."""
  if (given := getattr(wanted, flag)) is None:
    return [None] * len(motions)
  path = Path(given)
  if path.suffix and len(motions) > 1:
    raise UsageError(f"{path}: {len(motions)} clips need a folder, not a file; --concatenate joins them")
  targets = [path] if path.suffix else [path / f"{safe_name(motion.name)}{ending}" for motion in motions]
  if len(set(targets)) < len(targets):
    raise UsageError(f"two clips would have the same file name in {path}; rename one of them")
  return [output_file(f"--{flag}", target, ending, force=wanted.force) for target in targets]
