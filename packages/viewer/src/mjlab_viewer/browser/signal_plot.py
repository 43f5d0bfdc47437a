"""Curves of the environment's signals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import viser
from viser import uplot

from mjlab_viewer.snapshot import Snapshot

MOST_CURVES = 12
_COLORS = """#4269d0 #efb118 #ff725c #6cc5b0 #3ca951 #ff8ab7 #a463f2 #97bbf5 #9c6b4e #9498a0 #1f77b4 #d62728""".split()


class SignalPlot:
  """Curves of one group of signals, filtered by a word; added at the present place of the page.

  Args:
    server: Server of the page.
    group: Name of the group.
    names: Names of its signals.
  """

  def __init__(self, server: viser.ViserServer, group: str, names: Sequence[str]) -> None:
    self._server = server
    self._group, self._names, self._word = group, names, ""
    self._filter = server.gui.add_text("Filter", "", hint="Show only names that contain this")
    self._folder = server.gui.add_folder("Curves")
    self._shown: list[int] = []
    self._plot: viser.GuiUplotHandle | None = None
    self._more: viser.GuiMarkdownHandle | None = None
    self._make()

  def show(self, history: Sequence[Snapshot], step_dt: float) -> None:
    """Draw the signals of a run of snapshots of the same selected world."""
    if self._filter.value != self._word:
      self._word = self._filter.value
      self._make()
    if self._plot is None or not history:
      return
    time = np.array([snapshot.step for snapshot in history]) * step_dt
    values = np.stack([snapshot.signals[self._group] for snapshot in history])
    self._plot.data = (time, *(_bridged(time, values[:, index].astype(np.float64)) for index in self._shown))

  def _make(self) -> None:
    for part in (self._plot, self._more):
      if part is not None:
        part.remove()
    self._plot = self._more = None
    names = self._names
    found = [index for index, name in enumerate(names) if self._word.lower() in name.lower()]
    self._shown = found[:MOST_CURVES]
    with self._folder:
      if not found:
        self._more = self._server.gui.add_markdown(f"No name contains “{self._word}”.")
        return
      series = [uplot.Series(label="time [s]")]
      for color, index in zip(_COLORS, self._shown, strict=False):
        series.append(uplot.Series(label=names[index], stroke=color, width=1.5))
      empty = tuple(np.zeros(1) for _ in series)
      self._plot = self._server.gui.add_uplot(empty, tuple(series), scales={"x": uplot.Scale(time=False)}, aspect=1.3)
      if len(found) > len(self._shown):
        self._more = self._server.gui.add_markdown(f"{len(found) - len(self._shown)} more; filter to see them.")


def _bridged(time: np.ndarray, values: np.ndarray) -> np.ndarray:
  """Return values with a line over those that are not finite, which would spoil the plot; zeros if none is finite."""
  finite = np.isfinite(values)
  return np.interp(time, time[finite], values[finite]) if finite.any() else np.zeros_like(values)
