"""Plots of evaluations, of inspected events and of sweeps."""

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mjlab_rl
import numpy as np
import torch
from mjlab_core import matrix_from_quat
from mjlab_core.io.figures import figure, require_matplotlib
from mjlab_dr import LogUniform

if TYPE_CHECKING:
  from mjlab_dr import Distribution

  from mjlab.inspection import AxisReport, EventReport, InertiaReport

MOST_GROUPS = 30
"""Number of groups that a plot shows."""
_MOST_PANELS = 40
_BLUE, _GREY = "#1b6ca8", "#c9ced3"
_STYLE: Any = {
  "font.size": 7,
  "axes.titlesize": 8,
  "axes.labelsize": 8,
  "axes.spines.top": False,
  "axes.spines.right": False,
  "grid.alpha": 0.3,
}


def _figure(path: Path, width: float, height: float) -> AbstractContextManager[Any]:
  """Return a context of a new figure in our style, which is written at the end; sizes are in inches."""
  return figure(path, (width, height), package="mjlab", dpi=110, style=_STYLE)


def _with_unit(evaluation: "mjlab_rl.Evaluation", metric: str, gap: str) -> str:
  unit = evaluation.units.get(metric, "")
  return f"{metric}{gap}[{unit}]" if unit else metric


def plot_groups(evaluation: "mjlab_rl.Evaluation", path: Path) -> None:
  """Plot each metric of each group as a point with its interval."""
  groups = list(evaluation.groups)[:MOST_GROUPS]
  metrics = list(evaluation.groups["all"])
  with _figure(path, 2.6 * len(metrics), 1.1 + 0.34 * len(groups)) as drawn:
    panels = drawn.subplots(1, len(metrics), sharey=True, squeeze=False)[0]
    rows = np.arange(len(groups))
    for panel, metric in zip(panels, metrics, strict=True):
      intervals = [evaluation.groups[group][metric] for group in groups]
      mean, low, high = np.array([(interval.mean, interval.low, interval.high) for interval in intervals]).T
      # The mean is within its percentiles but for rounding.
      around = np.clip([mean - low, high - mean], 0.0, None)
      panel.errorbar(mean, rows, xerr=around, fmt="o", markersize=4, capsize=2)
      panel.set_title(_with_unit(evaluation, metric, " "))
      panel.grid(axis="x")
      if metric.endswith("_rate"):
        panel.set_xlim(-0.03, 1.03)
    panels[0].set_yticks(rows, groups)
    panels[0].set_ylim(len(groups) - 0.5, -0.5)


def plot_curves(evaluation: "mjlab_rl.Evaluation", path: Path) -> None:
  """Plot each curve over the seconds of an episode, one line for each group."""
  with _figure(path, 8.0, 1.7 * len(evaluation.curves) + 0.4) as drawn:
    panels = drawn.subplots(len(evaluation.curves), sharex=True, squeeze=False)[:, 0]
    for panel, (metric, by_group) in zip(panels, evaluation.curves.items(), strict=True):
      shown = [name for name in by_group if name != "all" or len(by_group) == 1]
      for name in shown[:MOST_GROUPS]:
        line = by_group[name]
        panel.plot(np.arange(len(line)) + 0.5, line, marker=".", linewidth=1, label=name)
      panel.set_ylabel(_with_unit(evaluation, metric, "\n"))
      panel.grid()
    panels[-1].set_xlabel("second of the episode")
    if len(panels[0].get_lines()) <= 10:
      panels[0].legend()


def plot_inspection(reports: "list[EventReport]", inertia: "InertiaReport", title: str, path: Path) -> None:
  """Draw a panel for every axis, every entity's mass, and every body whose inertia differs; at most 40."""
  drawings: list[Any] = [
    partial(_draw_axis, report=report, axis=axis, asked=axis.distribution)
    for report in reports
    for axis in report.axes
    if axis.distribution is not None
  ]
  drawings += [partial(_draw_mass, name=name, masses=masses) for name, masses in inertia.masses.items()]
  drawings += [partial(_draw_ellipsoids, name=name, inertias=rows) for name, rows in inertia.bodies.items()]
  left_out = len(drawings) - _MOST_PANELS
  drawings = drawings[:_MOST_PANELS]
  columns = min(5, max(1, len(drawings)))
  lines = max(1, math.ceil(len(drawings) / columns))
  with _figure(path, 3.4 * columns, 2.7 * lines + 0.5) as drawn:
    for number, draw in enumerate(drawings, 1):
      draw(drawn.add_subplot(lines, columns, number))
    more = f" ({left_out} more panels left out)" if left_out > 0 else ""
    drawn.suptitle(f"{title}: grey as asked, blue as drawn{more}")


def _draw_axis(panel: Any, report: "EventReport", axis: "AxisReport", asked: "Distribution") -> None:
  generator = torch.Generator().manual_seed(0)
  sample = asked.sample((20_000,), generator=generator, device=torch.device("cpu"), dtype=torch.float64).numpy()
  drawn, label = axis.drawn.double().cpu().numpy(), axis.label
  if isinstance(asked, LogUniform):
    sample, drawn = np.log10(sample), np.log10(drawn[drawn > 0.0])
    label += ", logarithm to base 10"
  both = np.concatenate((sample, drawn))
  span = {"bins": 25, "range": (both.min(), max(both.max(), both.min() + 1e-9)), "density": True}
  panel.hist(sample, color=_GREY, **span)
  if drawn.size:
    panel.hist(drawn, color=_BLUE, histtype="step", linewidth=1.5, **span)
  color = "#c0392b" if axis.verdict.isupper() else "black"
  panel.set_title(f"{report.name} ({report.mode})\n{axis.field}: {axis.verdict}", color=color)
  panel.set_xlabel(label)
  panel.set_yticks([])


def _draw_mass(panel: Any, name: str, masses: torch.Tensor) -> None:
  compiled, *drawn = masses.tolist()
  panel.hist(drawn, bins=40, color=_BLUE)
  panel.axvline(compiled, color="black", linestyle=":", linewidth=1)
  panel.set_title(f"total mass of {name}")
  panel.set_xlabel("[kg]")
  panel.set_yticks([])


def _draw_ellipsoids(panel: Any, name: str, inertias: Iterable[torch.Tensor]) -> None:
  """Draw ellipsoids of uniform density with a body's inertia, seen along y; the compiled one in black."""
  com, moments, quat = (part[:31].double().cpu() for part in inertias)
  # Semi-axes squared are five times the second moments per mass.
  squares = 5.0 * (0.5 * moments.sum(-1, keepdim=True) - moments).clamp_min(1e-12)
  axes = matrix_from_quat(quat)
  shadow = ((axes * squares.unsqueeze(-2)) @ axes.mT)[:, [0, 2]][:, :, [0, 2]]
  angle = torch.linspace(0.0, 2.0 * torch.pi, 61, dtype=torch.float64)
  # A square root of the matrix of an ellipse maps the unit circle to its outline.
  outlines = com[:, [0, 2], None] + torch.linalg.cholesky(shadow) @ torch.stack((angle.cos(), angle.sin()))
  x, z = outlines.permute(1, 2, 0).numpy()
  panel.plot(x[:, 1:], z[:, 1:], color=_BLUE, alpha=0.35, linewidth=1)
  panel.plot(x[:, 0], z[:, 0], color="black", linewidth=1.5)
  panel.set_aspect("equal", adjustable="datalim")
  panel.set_title(f"{name}: inertia ellipsoids, 30 worlds")
  panel.set_xlabel("x [m]; upwards z [m]")


def plot_trials(
  columns: Mapping[str, Sequence[Any]], rewards: Sequence[float], logarithmic: set[str], path: Path
) -> None:
  """Plot trials as lines over parallel axes, one for each value and one for the reward, which is also the color."""
  named = {**columns, "reward": rewards}
  heights = np.zeros((len(named), len(rewards)))
  with _figure(path, 1.6 + 1.9 * len(named), 4.6) as drawn:
    panel = drawn.subplots()
    for place, (name, values) in enumerate(named.items()):
      heights[place], ticks = _heights(values, name in logarithmic)
      panel.axvline(place, color="black", linewidth=0.8)
      for label, height in ticks.items():
        panel.annotate(f" {label}", (place, height), va="center")
    shade = require_matplotlib("mjlab").colormaps["viridis"]
    # The best trial is drawn last.
    for trial in np.argsort(np.nan_to_num(rewards, nan=-np.inf)):
      panel.plot(heights[:, trial], color=shade(heights[-1, trial]), alpha=0.8)
    panel.set_xticks(range(len(named)), list(named))
    panel.set_yticks([])
    panel.set_xlim(-0.1, len(named) - 0.55)
    panel.spines[:].set_visible(False)


def _heights(values: Sequence[Any], is_log: bool) -> tuple[np.ndarray, dict[str, float]]:
  """Return the heights of values on an axis from 0 to 1, and those of its labels."""
  if {type(value) for value in values} <= {int, float}:
    numbers = np.log10(values) if is_log else np.array(values, dtype=float)
    ticks = np.linspace(np.nanmin(numbers), np.nanmax(numbers), 5)
    labels = [f"{10**tick if is_log else tick:.3g}" for tick in ticks]
  else:
    labels = list(dict.fromkeys(map(str, values)))
    numbers = np.array([labels.index(str(value)) for value in values], dtype=float)
    ticks = np.arange(len(labels), dtype=float)
  span = ticks[-1] - ticks[0] or 1.0
  return (numbers - ticks[0]) / span, dict(zip(labels, (ticks - ticks[0]) / span, strict=True))
