"""Progress of a training on a terminal or in a log file."""

import contextlib
import errno
import shutil
import sys
import time
from collections.abc import Generator
from typing import Literal, TextIO

from mjlab_rl.scalar_log import IterationReport

Verbosity = Literal["quiet", "normal", "verbose"]

_PLAIN_INTERVAL = 5.0


class Console:
  """Progress on a terminal: one live line; elsewhere a plain line every five seconds.

  Args:
    verbosity: quiet: nothing; verbose: all values of every iteration.
    stream: Where to write; None: standard output.
  """

  def __init__(self, verbosity: Verbosity = "normal", stream: TextIO | None = None):
    self._verbosity = verbosity
    self._stream = stream if stream is not None else sys.stdout
    self._is_live = verbosity == "normal" and self._stream.isatty()
    self._line_open = False
    self._last_line = -_PLAIN_INTERVAL

  @property
  def is_verbose(self) -> bool:
    """True if details are shown."""
    return self._verbosity == "verbose"

  def say(self, text: str) -> None:
    """Write one message on lines of its own."""
    if self._verbosity == "quiet":
      return
    self.end_line()
    self._write(text + "\n")

  def show(self, report: IterationReport) -> None:
    """Show one iteration."""
    if self._verbosity == "quiet":
      return
    if self._verbosity == "verbose":
      self._write(_block(report) + "\n")
    elif self._is_live:
      self._write("\r\x1b[2K" + summary(report, shutil.get_terminal_size().columns - 1))
      self._line_open = True
    else:
      now = time.monotonic()
      is_last = report.iteration + 1 == report.end
      if is_last or now - self._last_line >= _PLAIN_INTERVAL:
        self._last_line = now
        self._write(summary(report) + "\n")

  @contextlib.contextmanager
  def live(self) -> Generator[None]:
    """End the live line on leaving, so that later text begins a new one."""
    try:
      yield
    finally:
      self.end_line()

  def end_line(self) -> None:
    """End the live line; later text begins below it."""
    if self._line_open:
      self._line_open = False
      self._write("\n")

  def _write(self, text: str) -> None:
    try:
      self._stream.write(text)
      self._stream.flush()
    except OSError as error:
      if error.errno not in (errno.EIO, errno.EPIPE):
        raise
      # The terminal or the reader of the pipe is gone; the run goes on.
      self._verbosity = "quiet"


def summary(report: IterationReport, width: int | None = None) -> str:
  """Return one line of iteration, speed, reward, episode length and remaining time, shortened to `width`."""
  digits = len(str(report.end))
  parts = [f"{report.iteration + 1:>{digits}}/{report.end}", f"{_count(report.steps_per_second)} steps/s"]
  if report.mean_reward is not None and report.mean_episode_length is not None:
    parts += [f"reward {report.mean_reward:.2f}", f"episode {report.mean_episode_length:.0f} steps"]
  else:
    parts += ["no episode finished yet"]
  if (loss := report.scalars.get("Loss/behavior")) is not None:
    parts += [f"teacher error {loss:.3g}"]
  parts += [f"ETA {_duration(report.eta)}"]
  while width is not None and len("  ".join(parts)) > width and len(parts) > 2:
    # Iteration and remaining time stay; speed is dropped last.
    del parts[-2]
  return "  ".join(parts)


def _block(report: IterationReport) -> str:
  width = max(map(len, report.scalars), default=0)
  lines = [summary(report)]
  lines += [f"  {name:<{width}}  {value:.5g}" for name, value in report.scalars.items()]
  return "\n".join(lines)


def _count(value: float) -> str:
  return f"{value / 1e3:.0f}k" if value >= 10_000 else f"{value:.0f}"


def _duration(seconds: float) -> str:
  minutes, second = divmod(int(seconds), 60)
  hours, minute = divmod(minutes, 60)
  return f"{hours}:{minute:02d}:{second:02d}"
