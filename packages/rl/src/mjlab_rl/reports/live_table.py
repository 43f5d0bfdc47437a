"""Live display of a training in a terminal, drawn by rich."""

from collections.abc import Mapping
from typing import TextIO

from rich.columns import Columns
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table

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


def start_live(stream: TextIO) -> Live:
  """Start a display that is redrawn in place; text that the program prints appears above it.

  Args:
    stream: Terminal to draw on. Its errors are the owner's.
  """
  console = Console(file=stream, force_terminal=True, highlight=False, markup=False, emoji=False)
  live = Live(console=console, auto_refresh=False, vertical_overflow="crop")
  live.start()
  return live


def display(done: int, total: int, eta: str, line: str, values: Mapping[str, float]) -> Group:
  """Return a progress bar, one line of figures, and tables of all logged values.

  Args:
    done: Iterations done.
    total: Iterations in all.
    eta: Remaining time.
    line: Figures below the bar.
    values: Values by rsl-rl's tags.
  """
  bar = Table.grid(padding=(0, 2))
  bar.add_row(f"{done}/{total}", ProgressBar(total, done, _BAR), f"{100 * done // total} %", f"ETA {eta}")
  groups: dict[str, dict[str, float]] = {group: {} for group in _TITLES}
  for tag, value in values.items():
    group, _, name = tag.partition("/")
    groups.setdefault(group, {})[name] = value
  tables = [_table(group, found) for group, found in groups.items() if found and group not in ("Perf", "Train")]
  return Group(bar, line, Columns(tables, padding=(0, 4)))


def _table(group: str, values: Mapping[str, float]) -> Table:
  table = Table(
    box=None, pad_edge=False, show_header=False, title=_TITLES.get(group, group.lower()), title_justify="left"
  )
  table.add_column(no_wrap=True, overflow="ellipsis", max_width=32)
  table.add_column(justify="right", no_wrap=True)
  for name, value in values.items():
    table.add_row(name, f"{value:.4g}")
  return table
