"""Command line: `mjlab-deploy verify BUNDLE` and `mjlab-deploy run BUNDLE`."""

import argparse
import math
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

from mjlab_deploy.errors import DeployError

if TYPE_CHECKING:
  from mjlab_deploy.bundle import Bundle


def main(argv: Sequence[str] | None = None) -> int:
  """Run a command; return the exit code: 0 done, 1 failed, 2 wrong command line."""
  arguments = _parser().parse_args(argv)
  try:
    return arguments.function(arguments)
  except DeployError as error:
    # Names from files are part of messages.
    text = "".join(letter if letter.isprintable() else " " for letter in str(error))
    print(f"error: {text[:2000]}", file=sys.stderr)
    return 1
  except KeyboardInterrupt:
    print("interrupted", file=sys.stderr)
    return 130


def _parser() -> argparse.ArgumentParser:
  parser = argparse.ArgumentParser(prog="mjlab-deploy", description="Policy bundles of mjlab.")
  commands = parser.add_subparsers(required=True, metavar="COMMAND")
  verify = commands.add_parser("verify", help="replay the record of a bundle, then run its policy in MuJoCo C")
  verify.add_argument("bundle", help="folder or zip")
  verify.set_defaults(function=_verify)
  run = commands.add_parser("run", help="run a policy in MuJoCo C through the messages of a robot")
  run.add_argument("bundle", help="folder or zip, or a network of another project (.onnx) with --model")
  run.add_argument("--model", metavar="ROBOT.xml", help="MJCF file of the robot of such a network")
  run.add_argument("--rate", type=_positive, help="rate of such a network [Hz]; default: that of deploy.yaml, or 50")
  run.add_argument(
    "--viewer", action="store_true", help="show it in MuJoCo's viewer; arrow keys and , . or a gamepad give commands"
  )
  run.add_argument(
    "--seconds", type=_positive, help="length of the run [s]; default: 10, with the viewer until it is closed"
  )
  run.add_argument("--command", type=_numbers, default=[], metavar="X,Y,...", help="command, such as 0.5,0,0")
  run.add_argument("--latency", type=_seconds, default=0.0, metavar="10ms", help="delay of messages, each way")
  run.add_argument("--pushes", action="store_true", help="push a floating robot every 3 s, by up to 0.5 m/s")
  run.add_argument("--log", help="file.npz or file.mcap of measured and commanded joints")
  run.add_argument("--plot", metavar="FILE.png", help="picture of measured and commanded joints over time")
  run.set_defaults(function=_run)
  return parser


def _verify(arguments: argparse.Namespace) -> int:
  from mjlab_deploy.bundle import open_bundle
  from mjlab_deploy.simulation.verification import verify

  with open_bundle(arguments.bundle) as bundle:
    report = verify(bundle)
  for line in report.notes:
    print(line)
  for line in report.failures:
    print(f"FAILED {line}")
  print("verified" if report.passed else "not verified")
  return 0 if report.passed else 1


def _numbers(text: str) -> list[float]:
  try:
    return [float(word) for word in text.split(",")]
  except ValueError as error:
    raise argparse.ArgumentTypeError(f"expected numbers such as 0.5,0,0, got {text!r}") from error


def _positive(text: str) -> float:
  try:
    value = float(text)
  except ValueError:
    value = 0.0
  if not 0.0 < value < math.inf:
    raise argparse.ArgumentTypeError(f"expected a number above 0, got {text!r}")
  return value


def _seconds(text: str) -> float:
  try:
    value = float(text[:-2]) / 1000.0 if text.endswith("ms") else float(text.removesuffix("s"))
  except ValueError:
    value = -1.0
  if not 0.0 <= value <= 1.0:
    raise argparse.ArgumentTypeError(f"expected 0 to 1 s, such as 10ms, got {text!r}")
  return value


def _run(arguments: argparse.Namespace) -> int:
  from mjlab_deploy.robot.run_log import plot_joints, write_log
  from mjlab_deploy.simulation.simulated_run import SimulatedRun

  with _opened(arguments) as bundle:
    run = SimulatedRun(bundle, latency=arguments.latency, pushes=arguments.pushes, command=arguments.command)
    if arguments.viewer:
      run.watch(arguments.seconds)
    else:
      run.run(10.0 if arguments.seconds is None else arguments.seconds)
    for write, path in ((write_log, arguments.log), (plot_joints, arguments.plot)):
      if path is not None:
        write(Path(path), bundle.description.robot.joint_names, run.log())
        print(f"wrote {path}")
  print(run.summary())
  return 0 if run.runner.phase == "policy" else 1


def _opened(arguments: argparse.Namespace) -> "AbstractContextManager[Bundle]":
  """Open the bundle of a command line, or the network and the model."""
  from mjlab_deploy.bundle import open_bundle

  if not arguments.bundle.endswith(".onnx"):
    return open_bundle(arguments.bundle)
  if arguments.model is None:
    raise DeployError(f"{arguments.bundle} is a network without a robot; name its MJCF file with --model")
  from mjlab_deploy.formats.adoption import adopted

  return adopted(Path(arguments.bundle), Path(arguments.model), arguments.rate)
