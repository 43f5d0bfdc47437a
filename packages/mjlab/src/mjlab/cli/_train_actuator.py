"""`train-actuator RECORDS ... [flags]`: fit a network to records of a motor, for `LearnedMlpActuatorCfg`."""

import dataclasses
import math
import signal
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from mjlab_core import UsageError

from mjlab.cli._command_line import CommandLine, output_file, plot_problem

if TYPE_CHECKING:
  from mjlab_sysid import FitProgress, MotorFit


@dataclasses.dataclass(kw_only=True)
class Arguments:
  """All that can be given after the records."""

  output: str | None = None
  """File of the network; None: that of the first records, with suffix .pt."""
  plot: str | None = None
  """Picture of errors and efforts; None: that of the network, with suffix .png."""
  force: bool = False
  """Overwrite existing files."""
  joints: str = ".*"
  """Pattern of the joints whose motors the network stands for."""
  history_length: int = 3
  """Samples of position error and velocity that the network reads, with the present one; longer than the motor's
  delay."""
  hidden: tuple[int, ...] = (32, 32)
  """Widths of the hidden layers."""
  activation: Literal["softsign", "elu", "relu", "tanh"] = "softsign"
  """Activation function between the layers."""
  epochs: int = 100
  """Passes over the records."""
  batch_size: int = 128
  """Samples in one step of Adam."""
  learning_rate: float = 1e-2
  """Initial learning rate; it falls to zero along a cosine."""
  held_out: float = 0.2
  """Share at the end of each segment that is not trained on."""
  seed: int = 0
  """Seed of the initial weights and of the order of samples."""
  traceback: bool = False
  """Show the traceback of an error."""


_LINE = CommandLine(
  name="train-actuator",
  words="RECORD [RECORD ...]",
  purpose=(
    "Fits a network to the effort of a motor, from records of its commands and responses, and writes a file for "
    "LearnedMlpActuatorCfg. Ctrl-C ends the training after the current epoch and writes the network; a second Ctrl-C "
    "writes nothing."
  ),
  arguments=Arguments,
  notes="""\
records are .csv, .npz or .mcap files (docs/sysid.md); of each joint the command reads
  position_target, position [rad or m], velocity [rad/s or m/s], and effort [N m or N]: that of the motor from this
  row to the next. The network is used at the period of the first record.
""",
)


def run(words: list[str]) -> int:
  """Fit; return the exit code."""
  if _LINE.wants_help(words):
    return 0
  records, flags = _LINE.split(words, most=None)
  from mjlab.cli._flags import parse

  wanted = parse(Arguments(), flags)
  output = Path(wanted.output) if wanted.output is not None else Path(records[0]).with_suffix(".pt")
  plot = Path(wanted.plot) if wanted.plot is not None else output.parent / f"{output.stem}.png"
  _check_files(output, plot, wanted, records)
  return _fit(records, output, plot, wanted)


def _check_files(output: Path, plot: Path, wanted: Arguments, records: list[str]) -> None:
  if output == plot:
    raise UsageError(f"--plot: {plot} is the network's own file")
  for flag, path in (("output", output), ("plot", plot)):
    if path in map(Path, records):
      raise UsageError(f"--{flag}: {path} is one of the records")
    output_file(f"--{flag}", path, path.suffix.lower(), force=wanted.force)


def _fit(records: list[str], output: Path, plot: Path, wanted: Arguments) -> int:
  from mjlab_sysid import MotorFitCfg, fit_motor, read_records

  found = read_records(records)
  for record in found:
    print(f"{record.source}: {record.num_rows} rows every {record.period:g} s, joints {', '.join(record.joints)}")
    if record.ignored:
      print(f"not read: columns {', '.join(record.ignored)}")
  options = {field.name: getattr(wanted, field.name) for field in dataclasses.fields(MotorFitCfg)}
  with _Progress(wanted.epochs) as progress, stop_on_ctrl_c() as stopped:
    fit = fit_motor(found, MotorFitCfg(**options), lambda seen: progress.show(seen) or bool(stopped))
  _report(fit, wanted.epochs)
  fit.save(output)
  print(f"network: {output}")
  if problem := plot_problem():
    print(f"no plots: {problem}")
  else:
    fit.save_plot(plot)
    print(f"plot: {plot}")
  print(f"use it as: {fit.config(output)}")
  return 0


def _report(fit: "MotorFit", epochs: int) -> None:
  done = fit.curve[-1].epoch
  if done < epochs:
    print(f"stopped (Ctrl-C) after {done} of {epochs} epochs")
  stiffness, damping = fit.pd_gains
  print("root mean square error of the effort [N or N m]:")
  print(f"  network   train {fit.train_error:.4g}, held out {fit.held_out_error:.4g}")
  print(f"  best PD   held out {fit.pd_error:.4g} (stiffness {stiffness:.4g}, damping {damping:.4g})")
  motor = fit.motor
  words = [
    f"stiffness {motor.stiffness:.4g}",
    f"damping {motor.damping:.4g}",
    f"delay {motor.delay * fit.period:.3g} s",
  ]
  words += [f"friction {motor.friction:.3g}"]
  limits = {name: getattr(motor, name) for name in ("effort_limit", "saturation_effort", "velocity_limit")}
  words += [f"{name} {value:.4g}" for name, value in limits.items() if math.isfinite(value)]
  print(f"  motor     held out {fit.motor_error:.4g} ({', '.join(words)})")


@contextmanager
def stop_on_ctrl_c() -> Generator[list[int], None, None]:
  """Yield a list that is filled by the first Ctrl-C; the second raises KeyboardInterrupt as usual."""
  stopped: list[int] = []

  def stop(number: int, _: object) -> None:
    stopped.append(number)
    signal.signal(signal.SIGINT, before)

  before = signal.signal(signal.SIGINT, stop)
  try:
    yield stopped
  finally:
    signal.signal(signal.SIGINT, before)


class _Progress:
  """Progress line, rewritten in place on a terminal and repeated at intervals elsewhere."""

  def __init__(self, epochs: int) -> None:
    self._epochs, self._begin, self._shown = epochs, 0.0, float("-inf")
    self._live = sys.stdout.isatty()

  def __enter__(self) -> "_Progress":
    return self

  def __exit__(self, *_: object) -> None:
    if self._live:
      print()

  def show(self, seen: "FitProgress") -> None:
    now = time.monotonic()
    if seen.epoch == 1:
      # The first pays for what torch loads late.
      self._begin = now
    if now - self._shown < (0.1 if self._live else 5.0) and seen.epoch < self._epochs:
      return
    self._shown = now
    text = f"epoch {seen.epoch}/{self._epochs}  error: train {seen.train_error:.4g}, held out {seen.held_out_error:.4g}"
    if 1 < seen.epoch < self._epochs:
      text += f"  {(now - self._begin) / (seen.epoch - 1) * (self._epochs - seen.epoch):.0f} s left"
    print(f"\r\033[K{text}" if self._live else text, end="" if self._live else "\n", flush=True)
