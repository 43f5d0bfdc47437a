"""`fit-actuator RECORDS.csv ... [flags]`: teach a network a motor, for `LearnedMlpActuatorCfg`."""

import dataclasses
import itertools
import signal
import sys
import textwrap
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from mjlab import making
from mjlab.cli._config_flags import flags
from mjlab.cli._errors import UsageError

if TYPE_CHECKING:
  from mjlab_actuators import FitProgress, MotorFit


@dataclasses.dataclass(kw_only=True)
class Arguments:
  """All that can be given after the records."""

  output: str | None = None
  """File of the network; None: that of the first records, with the ending .pt."""
  plot: str | None = None
  """Picture of errors and efforts; None: that of the network, with the ending .png."""
  force: bool = False
  """Overwrite files that exist."""
  history_length: int = 3
  """Samples of position error and velocity that the network sees, the present one included; longer than the motor's
  delay."""
  hidden: tuple[int, ...] = (32, 32)
  """Widths of the hidden layers."""
  activation: Literal["softsign", "elu", "relu", "tanh"] = "softsign"
  """Between the layers."""
  epochs: int = 100
  """Passes over the records."""
  batch_size: int = 128
  """Samples of one step of Adam."""
  learning_rate: float = 1e-2
  """At the beginning; it falls to zero along a cosine."""
  held_out: float = 0.2
  """Share at the end of each segment that is never trained on."""
  seed: int = 0
  """Of the first weights and of the order of the samples."""
  traceback: bool = False
  """Show where an error came from."""


_HELP = """\
usage: fit-actuator RECORDS.csv [MORE.csv ...] [flags]

Teaches a network what effort a motor gives, from records of what it was told and what it did, and writes it as
LearnedMlpActuatorCfg loads it. Ctrl-C ends the training after the running epoch and writes what was learned; a second
one writes nothing.

columns of the records, in any order, named in the first line:
  time             when the row was taken [s], rows at one period: the timestep of the simulation that is to use it
  position_target  set-point of the position [m or rad]
  position         measured position [m or rad]
  velocity         measured velocity [m/s or rad/s]
  effort           what the motor gave from this row to the next [N or N m]
  segment          optional: rows with the same text in a row belong together, time may begin anew where it changes

flags:
"""


def run(arguments: list[str]) -> int:
  """Fit; returns the exit code."""
  if "-h" in arguments or "--help" in arguments:
    lines = (f"  --{flag.name:<15} {flag.about} [{_shown(flag.value)}]" for flag in flags(Arguments()))
    print(_HELP + "\n".join(textwrap.fill(line, 120, subsequent_indent=" " * 20) for line in lines))
    return 0
  records = list(itertools.takewhile(lambda word: not word.startswith("-"), arguments))
  if not records:
    raise UsageError("no records given. usage: fit-actuator RECORDS.csv [MORE.csv ...] [flags]")
  making.share_cores()
  from mjlab.cli._flag_parser import parse

  wanted = parse(Arguments(), arguments[len(records) :])
  output = Path(wanted.output) if wanted.output is not None else Path(records[0]).with_suffix(".pt")
  plot = Path(wanted.plot) if wanted.plot is not None else output.parent / f"{output.stem}.png"
  _check_files(output, plot, wanted, records)
  return _fit(records, output, plot, wanted)


def _shown(value: object) -> str:
  return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _check_files(output: Path, plot: Path, wanted: Arguments, records: list[str]) -> None:
  if output == plot:
    raise UsageError(f"--plot: {plot} is the network's own file")
  for flag, path in (("output", output), ("plot", plot)):
    if path in map(Path, records):
      raise UsageError(f"--{flag}: {path} is one of the records")
    if path.is_dir():
      raise UsageError(f"--{flag}: {path} is a folder; name a file in it")
    if not path.parent.is_dir():
      raise UsageError(f"--{flag}: folder {path.parent} does not exist")
    if path.exists() and not wanted.force:
      raise UsageError(f"--{flag}: {path} exists; name another file, or overwrite it with --force")


def _fit(records: list[str], output: Path, plot: Path, wanted: Arguments) -> int:
  from mjlab_actuators import MotorFitCfg, fit_motor, read_records

  found = read_records(records)
  stretches = "1 segment" if len(found.segments) == 1 else f"{len(found.segments)} segments"
  print(f"{found.num_rows} rows in {stretches}, every {found.period:g} s")
  if found.ignored:
    print(f"not read: columns {', '.join(found.ignored)}")
  options = {field.name: getattr(wanted, field.name) for field in dataclasses.fields(MotorFitCfg)}
  with _Progress(wanted.epochs) as progress, _stop_on_ctrl_c() as stopped:
    fit = fit_motor(found, MotorFitCfg(**options), lambda seen: progress.show(seen) or bool(stopped))
  _report(fit, wanted.epochs)
  fit.save(output)
  print(f"network: {output}")
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


@contextmanager
def _stop_on_ctrl_c() -> Generator[list[int], None, None]:
  """A list that the first Ctrl-C makes true; the second is a KeyboardInterrupt as ever."""
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
  """One line that is written over on a terminal, a line now and then elsewhere."""

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
