"""Live display of a training in a terminal, drawn by rich."""

from collections.abc import Mapping
from typing import TextIO

from rich.columns import Columns
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from mjlab_rl.scalar_log import IterationReport

_BAR = 40
# Titles of the tables by the first part of their tags. A low terminal shows the first tables only. The lines above the
# tables show "Perf" and "Train".
_TITLES = {
  "Episode_Reward": "reward terms",
  "Episode_Metrics": "metrics",
  "Metrics": "commands",
  "Episode_Termination": "terminations",
  "Curriculum": "curriculum",
  "Nonfinite": "not finite",
}


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

  def show(self, report: IterationReport, *, eta: str, line: str) -> None:
    """Draw the state after an iteration, with the remaining time and a line of figures below the bar."""
    # Means over episodes are missing while no episode ends; the last ones stay.
    self._values |= report.scalars
    done, total = report.iteration + 1, report.end
    bar = Table.grid(padding=(0, 2))
    bar.add_row(f"{done}/{total}", ProgressBar(total, done, _BAR), f"{100 * done // total} %", f"ETA {eta}")
    groups: dict[str, dict[str, float]] = {group: {} for group in _TITLES}
    for tag, value in self._values.items():
      group, _, name = tag.partition("/")
      groups.setdefault(group, {})[name] = value
    tables = [_table(group, values) for group, values in groups.items() if values and group not in ("Perf", "Train")]
    self._live.update(Group(bar, Text(line), Columns(tables, padding=(0, 4))), refresh=True)

  def close(self) -> None:
    """Leave the last state on the terminal; later text begins below it."""
    self._live.stop()


def _table(group: str, values: Mapping[str, float]) -> Table:
  table = Table(
    box=None, pad_edge=False, show_header=False, title=_TITLES.get(group, group.lower()), title_justify="left"
  )
  table.add_column(no_wrap=True, overflow="ellipsis", max_width=32)
  table.add_column(justify="right", no_wrap=True)
  for name, value in values.items():
    table.add_row(name, f"{value:.4g}")
  return table
