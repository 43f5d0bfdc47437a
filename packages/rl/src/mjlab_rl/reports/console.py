"""Progress of a training on a terminal or in a log file."""

import contextlib
import errno
import os
import sys
import time
from collections.abc import Callable, Generator
from typing import TYPE_CHECKING, Literal, TextIO, cast

from mjlab_rl.reports.scalar_log import IterationReport

if TYPE_CHECKING:
  from rich.live import Live

Verbosity = Literal["quiet", "normal", "verbose"]

_PLAIN_INTERVAL = 5.0
_LIVE_INTERVAL = 0.25


class Console:
  """Progress on a terminal: a live display; elsewhere a plain line every five seconds.

  Args:
    verbosity: quiet: nothing; verbose: all values of every iteration, line by line.
    stream: Where to write; None: standard output.
  """

  def __init__(self, verbosity: Verbosity = "normal", stream: TextIO | None = None):
    self._verbosity = verbosity
    self._stream = cast("TextIO", _Surviving(stream if stream is not None else sys.stdout))
    is_terminal = self._stream.isatty() and os.environ.get("TERM") not in ("dumb", "unknown")
    self._is_live = verbosity == "normal" and is_terminal
    self._live: Live | None = None
    self._values: dict[str, float] = {}
    self._last_shown = -_PLAIN_INTERVAL
    self.on_report: list[Callable[[IterationReport], None]] = []
    """Functions called with every report, also by a quiet console."""

  @property
  def is_verbose(self) -> bool:
    """True if details are shown."""
    return self._verbosity == "verbose"

  def say(self, text: str) -> None:
    """Write a message on separate lines, above a live display."""
    if self._verbosity == "quiet":
      return
    if self._live is not None:
      self._live.console.print(text, soft_wrap=True)
    else:
      self._stream.write(text + "\n")

  def show(self, report: IterationReport) -> None:
    """Show one iteration."""
    for call in self.on_report:
      call(report)
    if self._verbosity == "quiet":
      return
    if self._verbosity == "verbose":
      width = max(map(len, report.scalars), default=0)
      lines = [f"  {name:<{width}}  {value:.5g}" for name, value in report.scalars.items()]
      self._stream.write("\n".join((summary(report), *lines, "")))
      return
    now = time.monotonic()
    is_last = report.iteration + 1 == report.end
    if is_last or now - self._last_shown >= (_LIVE_INTERVAL if self._is_live else _PLAIN_INTERVAL):
      self._last_shown = now
      if self._is_live:
        self._draw(report)
      else:
        self._stream.write(summary(report) + "\n")

  @contextlib.contextmanager
  def live(self) -> Generator[None]:
    """End the live display on leaving, so that later text begins below it."""
    try:
      yield
    finally:
      if self._live is not None:
        self._live.stop()
        self._live = None

  def _draw(self, report: IterationReport) -> None:
    # Imported here: most runs of a command never draw.
    from mjlab_rl.reports.live_table import display, start_live

    if self._live is None:
      self._live, self._values = start_live(self._stream), {}
    # Means over episodes are missing while no episode ends; the last ones stay.
    self._values |= report.scalars
    done = report.iteration + 1
    self._live.update(display(done, report.end, duration(report.eta), _figures(report), self._values), refresh=True)


class _Surviving:
  """Stream that ignores a closed terminal and a closed pipe, so that they do not end the run."""

  def __init__(self, stream: TextIO) -> None:
    self._inner: TextIO | None = stream
    self.encoding = stream.encoding

  def flush(self) -> None:
    """Do nothing: every write is flushed."""

  def isatty(self) -> bool:
    return self._inner is not None and self._inner.isatty()

  def write(self, text: str, /) -> int:
    try:
      if self._inner is not None:
        self._inner.write(text)
        self._inner.flush()
    except OSError as error:
      if error.errno not in (errno.EIO, errno.EPIPE):
        raise
      self._inner = None
    return len(text)


def summary(report: IterationReport) -> str:
  """Return one line of iteration, speed, reward, episode length and remaining time."""
  digits = len(str(report.end))
  return f"{report.iteration + 1:>{digits}}/{report.end}  {_figures(report)}  ETA {duration(report.eta)}"


def _figures(report: IterationReport) -> str:
  speed = report.steps_per_second
  parts = [f"{speed / 1e3:.0f}k steps/s" if speed >= 10_000 else f"{speed:.0f} steps/s"]
  if report.mean_reward is not None and report.mean_episode_length is not None:
    parts += [f"reward {report.mean_reward:.2f}", f"episode {report.mean_episode_length:.0f} steps"]
  else:
    parts += ["no episode finished yet"]
  if (loss := report.scalars.get("Loss/behavior")) is not None:
    parts += [f"teacher error {loss:.3g}"]
  return "  ".join(parts)


def duration(seconds: float) -> str:
  """Return a time as hours, minutes and seconds."""
  minutes, second = divmod(int(seconds), 60)
  return f"{minutes // 60}:{minutes % 60:02d}:{second:02d}"
