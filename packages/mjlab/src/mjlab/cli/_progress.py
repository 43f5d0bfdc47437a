"""Progress of commands: a bar, and an end by Ctrl-C."""

import signal
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from datetime import timedelta
from types import TracebackType
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
  from rich.progress import Progress

INTERVAL = 10.0
"""Time between two plain lines [s]."""


class ProgressBar:
  """Bar with the remaining time on a terminal, removed at the end; elsewhere a plain line every 10 s.

  It writes to standard error, so that results on standard output can be piped. On a terminal, text that the command
  prints meanwhile appears above it.

  Args:
    label: Name of the work.
    total: Number of its parts.
  """

  def __init__(self, label: str, total: int) -> None:
    self._label, self._total = label, total
    self._began = self._last_line = time.monotonic()
    self._rich: Progress | None = None

  def __enter__(self) -> Self:
    if sys.stderr.isatty():
      from rich.console import Console
      from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

      self._rich = Progress(
        "{task.description}",
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[note]}"),
        "ETA",
        TimeRemainingColumn(),
        console=Console(file=sys.stderr, markup=False, highlight=False),
        transient=True,
        # Output that is piped elsewhere stays there.
        redirect_stdout=sys.stdout.isatty(),
      )
      self._rich.add_task(self._label, total=self._total, note="")
      self._rich.start()
    return self

  def __exit__(
    self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
  ) -> None:
    if self._rich is not None:
      self._rich.stop()

  def show(self, done: float, note: str = "") -> None:
    """Show that `done` parts are done, with a note."""
    if self._rich is not None:
      self._rich.update(self._rich.task_ids[0], completed=done, note=note)
      return
    now = time.monotonic()
    # The last part needs no line, because the result follows.
    if now - self._last_line >= INTERVAL and 0 < done < self._total:
      self._last_line = now
      eta = timedelta(seconds=round((now - self._began) * (self._total - done) / done))
      parts = [f"{100 * done / self._total:.0f} %", *([note] if note else []), f"ETA {eta}"]
      print(f"{self._label}: {', '.join(parts)}", file=sys.stderr, flush=True)


@contextmanager
def stop_on_ctrl_c() -> Generator[list[int]]:
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
