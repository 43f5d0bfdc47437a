"""What a person watching the training sees."""

import shutil
import sys
import time
from typing import Literal, TextIO

from mjlab_rl.iteration_report import IterationReport

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
    """Whether details are wanted."""
    return self._verbosity == "verbose"

  def say(self, text: str) -> None:
    """Write one message on lines of its own."""
    if self._verbosity == "quiet":
      return
    self.end_line()
    print(text, file=self._stream, flush=True)

  def show(self, report: IterationReport) -> None:
    """Show one iteration."""
    if self._verbosity == "quiet":
      return
    if self._verbosity == "verbose":
      print(_block(report), file=self._stream, flush=True)
    elif self._is_live:
      width = shutil.get_terminal_size().columns
      self._stream.write("\r\x1b[2K" + summary(report)[: width - 1])
      self._stream.flush()
      self._line_open = True
    else:
      now = time.monotonic()
      is_last = report.iteration + 1 == report.end
      if is_last or now - self._last_line >= _PLAIN_INTERVAL:
        self._last_line = now
        print(summary(report), file=self._stream, flush=True)

  def end_line(self) -> None:
    """Leave the live line as it is and go on below it."""
    if self._line_open:
      self._stream.write("\n")
      self._line_open = False


def summary(report: IterationReport) -> str:
  """One line: iteration, speed, reward, episode length, time to go."""
  width = len(str(report.end))
  parts = [f"{report.iteration + 1:>{width}}/{report.end}", f"{_count(report.steps_per_second)} steps/s"]
  if report.mean_reward is not None and report.mean_episode_length is not None:
    parts += [f"reward {report.mean_reward:.2f}", f"episode {report.mean_episode_length:.0f} steps"]
  else:
    parts += ["no episode finished yet"]
  parts += [f"ETA {_duration(report.eta)}"]
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
