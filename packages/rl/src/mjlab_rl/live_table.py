"""Live display of a training in a terminal, drawn by rich."""

import itertools
from collections.abc import Mapping
from typing import TextIO

from rich.columns import Columns
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

_BAR = 40
# Tags that the first lines show, or that only log files need.
_HIDDEN = {"Perf", "Train"}
_NAMES = {
  "Episode_Reward": "reward terms",
  "Episode_Metrics": "metrics",
  "Episode_Termination": "terminations",
  "Metrics": "commands",
  "Nonfinite": "not finite",
}
# First what is watched most, because a low terminal shows the first tables only.
_ORDER = ("Episode_Reward", "Episode_Metrics", "Metrics", "Episode_Termination", "Curriculum", "Nonfinite")


class LiveTable:
  """Display that is redrawn in place: a progress bar, one line of figures, and tables of all logged values.

  While it is open, text that the program prints appears above it.

  Args:
    stream: Terminal to draw on. Its errors are the owner's.
  """

  def __init__(self, stream: TextIO) -> None:
    self._console = Console(file=stream, force_terminal=True, highlight=False, markup=False, emoji=False)
    self._live = Live(console=self._console, auto_refresh=False, vertical_overflow="crop")
    self._live.start()
    self._values: dict[str, float] = {}

  def say(self, text: str) -> None:
    """Write text above the display."""
    self._console.print(Text(text), soft_wrap=True)

  def show(self, *, done: int, total: int, eta: str, line: str, scalars: Mapping[str, float]) -> None:
    """Draw the state after an iteration.

    Args:
      done: Iterations done.
      total: Iterations in all.
      eta: Remaining time.
      line: Figures below the bar.
      scalars: Logged values by tag; the part before the first slash names the table. Values of missing tags stay.
    """
    # Means over episodes are missing while no episode ends; the last ones stay.
    self._values |= scalars
    bar = Table.grid(padding=(0, 2))
    bar.add_row(f"{done}/{total}", ProgressBar(total, done, _BAR), f"{100 * done // total} %", f"ETA {eta}")
    tables = Columns([_table(group, values) for group, values in _groups(self._values)], padding=(0, 4))
    self._live.update(Group(bar, Text(line), tables), refresh=True)

  def close(self) -> None:
    """Leave the last state on the terminal; later text begins below it."""
    self._live.stop()


def _groups(scalars: Mapping[str, float]) -> list[tuple[str, dict[str, float]]]:
  """Return the values of each table, the tables in the order of their use."""

  def place(tag: str) -> tuple[int, str]:
    group = tag.partition("/")[0]
    return (_ORDER.index(group) if group in _ORDER else len(_ORDER), group)

  shown = sorted((tag for tag in scalars if tag.partition("/")[0] not in _HIDDEN), key=place)
  return [
    (group, {tag.partition("/")[2]: scalars[tag] for tag in tags})
    for group, tags in itertools.groupby(shown, key=lambda tag: tag.partition("/")[0])
  ]


def _table(group: str, values: Mapping[str, float]) -> Table:
  table = Table(box=None, pad_edge=False, show_header=False, title=_NAMES.get(group, group.lower()))
  table.title_justify = "left"
  table.add_column(no_wrap=True, overflow="ellipsis", max_width=32)
  table.add_column(justify="right", no_wrap=True)
  for name, value in values.items():
    table.add_row(name, f"{value:.4g}")
  return table
