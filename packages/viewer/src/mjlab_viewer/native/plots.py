"""Curves of the environment's signals, over MuJoCo's window."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mjlab_viewer.snapshot import Snapshot

HISTORY = 500
"""Number of pictures that curves show."""
CURVES, FIGURES = 4, 3
"""Curves of a figure, and figures below one another."""

_COLORS = ((0.35, 0.6, 1.0), (1.0, 0.75, 0.2), (1.0, 0.45, 0.4), (0.45, 0.85, 0.5))


@dataclass(frozen=True)
class Page:
  """Signals that are plotted together."""

  group: str
  title: str
  first: int
  """Number within the group of the first signal."""
  names: tuple[str, ...]


class NativePlots:
  """Figures for the right third of the window, of one page of signals; at first without a page.

  Args:
    groups: Names of the signals by group.
  """

  def __init__(self, groups: Mapping[str, Sequence[str]]) -> None:
    pages = [page for group, names in groups.items() for page in _pages(group, names)]
    self._pages: deque[Page | None] = deque([None, *pages])
    self._kept: deque[Snapshot] = deque(maxlen=HISTORY)

  @property
  def page(self) -> Page | None:
    """Page that is plotted, or None."""
    return self._pages[0]

  def turn(self) -> None:
    """Show the next page, and after the last one none."""
    self._pages.rotate(-1)

  def add(self, snapshot: Snapshot) -> None:
    """Add a moment; another world starts new curves."""
    last = self._kept[-1] if self._kept else None
    if last is not None and last.worlds[0] != snapshot.worlds[0]:
      self._kept.clear()
    elif last is not None and last.step == snapshot.step:
      self._kept.pop()
    self._kept.append(snapshot)

  def figures(self, window: mujoco.MjrRect, step_dt: float) -> list[tuple[mujoco.MjrRect, mujoco.MjvFigure]]:
    """Return the figures and their places in the window."""
    page = self.page
    if page is None or not self._kept:
      return []
    time = np.array([snapshot.step for snapshot in self._kept]) * step_dt
    values = np.stack([snapshot.signals[page.group] for snapshot in self._kept])
    width, height = window.width // 3, window.height // FIGURES
    found = []
    for number, start in enumerate(range(0, len(page.names), CURVES)):
      names = page.names[start : start + CURVES]
      first = page.first + start
      figure = _figure(page.title if number == 0 else "", names, time, values[:, first : first + len(names)])
      bottom = window.bottom + window.height - (number + 1) * height
      found.append((mujoco.MjrRect(window.left + window.width - width, bottom, width, height), figure))
    return found


def _pages(group: str, names: Sequence[str]) -> list[Page]:
  most = CURVES * FIGURES
  count = -(-len(names) // most)
  titles = [group] if count == 1 else [f"{group} ({number + 1} of {count})" for number in range(count)]
  return [
    Page(group, title, number * most, tuple(names[number * most : (number + 1) * most]))
    for number, title in enumerate(titles)
  ]


def _figure(title: str, names: Sequence[str], time: np.ndarray, values: np.ndarray) -> mujoco.MjvFigure:
  figure = mujoco.MjvFigure()
  mujoco.mjv_defaultFigure(figure)
  figure.title = title
  figure.flg_extend, figure.flg_legend = 0, 1
  figure.range[:] = _range(time, 0.0), _range(values, 0.05)
  figure.gridsize[:] = (3, 4)
  figure.xformat, figure.yformat = "%.1f", "%.3g"
  figure.figurergba[:] = (0.1, 0.1, 0.1, 0.6)
  figure.legendrgba[:] = (0.0, 0.0, 0.0, 0.3)
  for number, (name, color) in enumerate(zip(names, _COLORS, strict=False)):
    finite = np.flatnonzero(np.isfinite(values[:, number]))
    figure.linename[number] = name.encode()[:99]
    figure.linergb[number] = color
    figure.linepnt[number] = len(finite)
    figure.linedata[number, : 2 * len(finite)] = np.stack([time[finite], values[finite, number]], axis=1).reshape(-1)
  return figure


def _range(values: np.ndarray, margin: float) -> tuple[float, float]:
  """Return the least and the greatest value, with a relative margin; the range is never empty."""
  finite = values[np.isfinite(values)]
  low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
  room = max(margin * (high - low), 1e-3, 1e-3 * abs(high))
  return low - room, high + room
