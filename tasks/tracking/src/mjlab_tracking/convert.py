"""`convert-motion CLIP ... --output FILE`: any clip of the field becomes a checked motion file."""

import argparse
import contextlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import mujoco
from mjlab_core.names import unknown

from mjlab_tracking.editing import concatenate, crop, mirror, smooth, to_ground
from mjlab_tracking.formats import JointMap, Statement, read_motion
from mjlab_tracking.kinematics import Kinematics, derived_arrays
from mjlab_tracking.library import shipped_clips
from mjlab_tracking.motion import Motion, MotionError, save_motion
from mjlab_tracking.preview import Preview
from mjlab_tracking.quality import check_quality
from mjlab_tracking.quality_plot import plot_quality
from mjlab_tracking.timeline import resample

EPILOG = """\
exit codes: 0 written, or only looked at; 1 the report has errors, no motion file written; 2 wrong usage, an unreadable
clip, or no way to show it.

examples:
  convert-motion dance.csv --rate 60 --ground --output dance.npz --report dance.png
  convert-motion walk.npz                                    a report, nothing written
  convert-motion march_in_place --preview                    a clip that ships, in a browser
  convert-motion clips/*.csv --rate 30 --output library/     a folder of clips
  convert-motion a.csv --rate 30 --robot my_robot.xml --joint-map map.json --output a.npz
"""


def robot_spec(name: str) -> mujoco.MjSpec:
  """A robot by name (g1, go1) or by the path of its MJCF.

  Raises:
    MotionError: There is no such robot or file, or it is no MJCF.
  """
  from mjlab_robots import g1_spec, go1_spec

  specs = {"g1": g1_spec, "go1": go1_spec}
  if name in specs:
    return specs[name](meshes="never")
  if not name.endswith(".xml"):
    raise MotionError(f"robot '{name}': neither one of {', '.join(specs)} nor the path of an .xml")
  if not Path(name).is_file():
    raise MotionError(f"robot {name}: no such file")
  try:
    spec = mujoco.MjSpec.from_file(name)
    spec.compile()
  except ValueError as error:
    raise MotionError(f"robot {name}: {error}") from error
  return spec


def main(argv: Sequence[str] | None = None) -> int:
  """`convert-motion`; returns the exit code."""
  options = _parser().parse_args(argv)
  try:
    return _convert(options)
  except (MotionError, OSError) as error:
    print(f"error: {error}", file=sys.stderr)
    return 2
  except KeyboardInterrupt:
    print("interrupted", file=sys.stderr)
    return 130


def _parser() -> argparse.ArgumentParser:
  parser = argparse.ArgumentParser(
    prog="convert-motion",
    description="Reads clips (.csv, .npz), edits them in the order of the options below, reports and writes them.",
    epilog=EPILOG,
    formatter_class=argparse.RawDescriptionHelpFormatter,
  )
  parser.add_argument("clips", nargs="+", type=Path, metavar="CLIP", help="a file, or the name of a clip that ships")
  parser.add_argument("--robot", default="g1", help="g1, go1 or the path of an MJCF (default: g1)")
  said = parser.add_argument_group("what the file does not say")
  said.add_argument("--rate", type=float, metavar="HZ", help="frames per second of the clip")
  said.add_argument("--quaternion", choices=("wxyz", "xyzw"), help="order in the file; without it, proven or refused")
  said.add_argument("--joint-names", type=_names, metavar="NAMES", help="of the joint columns: a,b,c or a text file")
  said.add_argument("--body-names", type=_names, metavar="NAMES", help="of the bodies of a seven-key .npz, likewise")
  said.add_argument(
    "--joint-map", type=Path, metavar="JSON", help='{"robot joint": "column" or the angle it is held at, ...}'
  )
  edit = parser.add_argument_group("edits, in this order")
  edit.add_argument("--crop", nargs=2, type=float, metavar=("START", "END"), help="keep the part between two times [s]")
  edit.add_argument("--output-rate", type=float, metavar="HZ", help="resample; training resamples by itself")
  edit.add_argument("--mirror", action="store_true", help="left becomes right")
  edit.add_argument("--concatenate", type=float, metavar="BLEND", help="join the clips, each blended so long [s]")
  edit.add_argument("--smooth", type=float, metavar="WIDTH", help="Gaussian of this deviation in time [s]")
  edit.add_argument("--ground", action="store_true", help="move up or down as a whole until the feet are on the ground")
  out = parser.add_argument_group("output")
  out.add_argument("--output", type=Path, metavar="PATH", help="an .npz, or a folder for several clips")
  out.add_argument(
    "--report", type=Path, metavar="PICTURE", help="draw the report: a .png (a folder for several clips)"
  )
  out.add_argument("--video", type=Path, metavar="FILM", help="film the clip: an .mp4 (a folder for several clips)")
  out.add_argument("--source", default=None, help="where the clip comes from")
  out.add_argument("--license", default=None, help="its terms, e.g. CC-BY-4.0")
  out.add_argument("--compact", action="store_true", help="without what follows from robot and joints")
  out.add_argument("--accept-errors", action="store_true", help="write in spite of errors in the report")
  out.add_argument("--force", action="store_true", help="replace files that are there")
  show = parser.add_argument_group("looking at it")
  show.add_argument("--preview", action="store_true", help="play the clip in a browser, at last")
  show.add_argument("--host", default="127.0.0.1", help="address to listen on; 0.0.0.0 lets other machines in")
  show.add_argument("--port", type=int, default=8080, help="port to listen on, the next free one if it is taken")
  return parser


def _names(text: str) -> tuple[str, ...]:
  path = Path(text)
  try:
    words = path.read_text(encoding="utf-8").replace(",", " ").split() if path.is_file() else text.split(",")
  except UnicodeDecodeError as error:
    raise argparse.ArgumentTypeError(f"{path} is no text") from error
  return tuple(word.strip() for word in words if word.strip())


def _convert(options: argparse.Namespace) -> int:
  spec = robot_spec(options.robot)
  robot = Kinematics(spec.compile())
  said = Statement(
    rate=options.rate,
    quaternion=options.quaternion,
    joint_names=options.joint_names,
    body_names=options.body_names,
    joint_map=None if options.joint_map is None else _joint_map(options.joint_map),
  )
  motions = [_edited(read_motion(_found(clip), robot, said), robot, options) for clip in options.clips]
  if options.concatenate is not None:
    motions = [concatenate(motions, blend=options.concatenate)]
  motions = [_finished(motion, robot, options) for motion in motions]
  if options.preview and len(motions) > 1:
    raise MotionError(f"--preview shows one clip, not {len(motions)}; --concatenate makes one of them")
  targets = _targets(options.output, motions, ".npz", options.force)
  pictures = _targets(options.report, motions, ".png", options.force)
  films = _targets(options.video, motions, ".mp4", options.force)
  preview = Preview(spec) if options.preview or options.video is not None else None
  # Before anything is written: where OpenGL is missing nothing is done by halves.
  with contextlib.nullcontext() if preview is None or options.video is None else preview.renderer() as renderer:
    has_errors = False
    for motion, target, picture, film in zip(motions, targets, pictures, films, strict=True):
      report = check_quality(motion, robot)
      print(report.table())
      if picture is not None:
        plot_quality(report, picture)
        print(f"drew {picture}")
      if report.severity == "error" and not options.accept_errors:
        has_errors = True
        if target is not None:
          print(f"not written: {target}, for the errors above; --accept-errors writes it all the same", file=sys.stderr)
      elif target is not None:
        save_motion(motion, target, None if options.compact else derived_arrays(motion, robot))
        print(f"wrote {target}: {motion.num_frames} frames at {motion.rate:g} Hz")
      if preview is not None and renderer is not None and film is not None:
        preview.film(motion, film, renderer)
        print(f"filmed {film}")
      print()
  if preview is not None and options.preview:
    preview.browse(motions[0], host=options.host, port=options.port)
  return int(has_errors)


def _found(clip: Path) -> Path:
  """The file that is meant: this one, or that of a clip that ships."""
  shipped = shipped_clips()
  if not clip.is_file() and str(clip) in shipped:
    return shipped[str(clip)]
  if clip.is_dir():
    raise MotionError(f"{clip} is a folder; name the clips in it: {clip}/*")
  if not clip.exists() and not clip.suffix:
    raise MotionError(f"{unknown('clip', str(clip), list(shipped))} It may also be the path of a .csv or .npz.")
  return clip


def _edited(motion: Motion, robot: Kinematics, options: argparse.Namespace) -> Motion:
  """What is done to each clip before clips are joined."""
  if options.crop is not None:
    motion = crop(motion, *options.crop)
  if options.output_rate is not None:
    motion = resample(motion, options.output_rate)
  return mirror(motion, robot) if options.mirror else motion


def _finished(motion: Motion, robot: Kinematics, options: argparse.Namespace) -> Motion:
  """What is done to each clip that is written."""
  if options.smooth is not None:
    motion = smooth(motion, options.smooth)
  if options.ground:
    motion = to_ground(motion, robot)
  if options.source is not None:
    motion = motion.changed("source stated", source=options.source)
  if options.license is not None:
    motion = motion.changed("licence stated", license=options.license)
  return motion


def _joint_map(path: Path) -> JointMap:
  try:
    table = json.loads(path.read_text(encoding="utf-8"))
  except ValueError as error:
    raise MotionError(f"{path}: not JSON ({error})") from error
  if not isinstance(table, dict) or not all(
    isinstance(value, str | int | float) and not isinstance(value, bool) for value in table.values()
  ):
    raise MotionError(f'{path}: expected {{"robot joint": "column" or a number, ...}}')
  return table


def _targets(path: Path | None, motions: Sequence[Motion], ending: str, force: bool) -> list[Path | None]:
  """Where each motion goes; nothing is there yet unless it may be replaced."""
  if path is None:
    return [None] * len(motions)
  if path.suffix not in ("", ending):
    raise MotionError(f"{path}: expected a file that ends in {ending}, or a folder")
  if path.suffix and len(motions) > 1:
    raise MotionError(f"{path}: {len(motions)} clips need a folder, not a file; --concatenate makes one of them")
  if path.suffix:
    targets = [path]
  else:
    targets = [path / f"{motion.name}{ending}" for motion in motions]
  taken = [target for target in targets if target.exists()]
  if taken and not force:
    raise MotionError(f"{taken[0]} is there already; --force replaces it")
  if len(set(targets)) < len(targets):
    raise MotionError(f"two clips would both be written to {targets[0].parent}; rename one of them")
  return [*targets]
