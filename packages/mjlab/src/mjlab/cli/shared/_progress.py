"""Progress of commands: a bar, and an end by Ctrl-C."""

import importlib
import signal
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from datetime import timedelta
from typing import Any

INTERVAL = 10.0
"""Time between two plain lines [s]."""


@contextmanager
def progress_bar(label: str, total: int) -> Generator[Callable[[float, str], None]]:
  """Yield a function that shows how many parts are done, and a note.

  A terminal shows a bar with the remaining time, which is removed at the end; text that the command prints meanwhile
  appears above it. Elsewhere there is a plain line every 10 s. Both go to standard error, so that results on standard
  output can be piped.

  Args:
    label: Name of the work.
    total: Number of its parts.
  """
  if not sys.stderr.isatty():
    yield _printer(label, total)
    return
  from rich.console import Console
  from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

  with Progress(
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
  ) as bar:
    task = bar.add_task(label, total=total, note="")
    yield lambda done, note: bar.update(task, completed=done, note=note)


def _printer(label: str, total: int) -> Callable[[float, str], None]:
  """Return a function that prints a line if the last one is `INTERVAL` old."""
  began = last = time.monotonic()

  def show(done: float, note: str) -> None:
    nonlocal last
    now = time.monotonic()
    # The last part needs no line, because the result follows.
    if now - last >= INTERVAL and 0 < done < total:
      last = now
      eta = timedelta(seconds=round((now - began) * (total - done) / done))
      print(f"{label}: {100 * done / total:.0f} %, {note}, ETA {eta}", file=sys.stderr, flush=True)

  return show


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


def imported(name: str) -> Any:
  """Return a module, and raise a Ctrl-C after its import: trimesh catches one while it imports, and goes on."""
  with stop_on_ctrl_c() as stopped:
    module = importlib.import_module(name)
  if stopped:
    raise KeyboardInterrupt
  return module
