"""Plots of evaluations, of inspected events and of sweeps."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from mjlab_core import AtomicWrite, matrix_from_quat
from mjlab_dr import LogUniform

if TYPE_CHECKING:
  from mjlab_rl import Evaluation

  from mjlab.inspection import AxisReport, EventReport, InertiaReport

MOST_GROUPS = 30
"""Number of groups that a plot shows."""
_BLUE, _GREY = "#1b6ca8", "#c9ced3"


def plot_groups(evaluation: "Evaluation", path: Path) -> None:
  """Plot each metric of each group as a point with its interval."""
  groups = list(evaluation.groups)[:MOST_GROUPS]
  metrics = list(evaluation.groups["all"])
  figure = Figure(figsize=(2.6 * len(metrics), 0.6 + 0.34 * len(groups) + 0.5), layout="constrained")
  axes = np.atleast_1d(figure.subplots(1, len(metrics), sharey=True))
  rows = np.arange(len(groups))
  for axis, metric in zip(axes, metrics, strict=True):
    intervals = [evaluation.groups[group][metric] for group in groups]
    means = np.array([interval.mean for interval in intervals])
    below = means - np.array([interval.low for interval in intervals])
    above = np.array([interval.high for interval in intervals]) - means
    # The mean is within its percentiles but for rounding.
    axis.errorbar(means, rows, xerr=np.clip([below, above], 0.0, None), fmt="o", markersize=4, capsize=2)
    unit = evaluation.units.get(metric, "")
    axis.set_title(f"{metric} [{unit}]" if unit else metric, fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(axis="x", alpha=0.3)
    if metric.endswith("_rate"):
      axis.set_xlim(-0.03, 1.03)
  axes[0].set_yticks(rows, groups, fontsize=7)
  axes[0].set_ylim(len(groups) - 0.5, -0.5)
  figure.savefig(path, dpi=110)


def plot_curves(evaluation: "Evaluation", path: Path) -> None:
  """Plot each curve over the seconds of an episode, one line for each group."""
  figure = Figure(figsize=(8, 1.7 * len(evaluation.curves) + 0.4), layout="constrained")
  axes = np.atleast_1d(figure.subplots(len(evaluation.curves), 1, sharex=True))
  for axis, (metric, by_group) in zip(axes, evaluation.curves.items(), strict=True):
    shown = {name: line for name, line in by_group.items() if name != "all" or len(by_group) == 1}
    for name, line in list(shown.items())[:MOST_GROUPS]:
      axis.plot(np.arange(len(line)) + 0.5, line, marker=".", linewidth=1, label=name)
    unit = evaluation.units.get(metric, "")
    axis.set_ylabel(f"{metric}\n[{unit}]" if unit else metric, fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3)
  axes[-1].set_xlabel("second of the episode", fontsize=8)
  if len(axes[0].get_lines()) <= 10:
    axes[0].legend(fontsize=7)
  figure.savefig(path, dpi=110)


def plot_inspection(reports: "list[EventReport]", inertia: "InertiaReport", title: str, path: Path) -> None:
  """Draw a panel for every axis, every entity's mass, and every body whose inertia differs; at most 40."""
  axes = [(report, axis) for report in reports for axis in report.axes]
  panels: list[Any] = [lambda panel, r=report, a=axis: _draw_axis(panel, r, a) for report, axis in axes]
  panels += [lambda panel, n=name: _draw_mass(panel, n, inertia) for name in inertia.masses]
  panels += [lambda panel, n=name: _draw_ellipsoids(panel, n, inertia) for name in inertia.bodies]
  left_out = max(0, len(panels) - 40)
  panels = panels[:40]
  columns = min(5, max(1, len(panels)))
  lines = -(-len(panels) // columns) or 1
  figure = Figure(figsize=(3.4 * columns, 2.7 * lines + 0.5), layout="constrained")
  grid = figure.subplots(lines, columns, squeeze=False).ravel()
  for panel, paint in zip(grid, panels, strict=False):
    paint(panel)
  for panel in grid[len(panels) :]:
    panel.set_axis_off()
  more = f" ({left_out} more panels left out)" if left_out else ""
  figure.suptitle(f"{title}: grey as asked, blue as drawn{more}")
  with AtomicWrite(path) as temporary:
    figure.savefig(temporary, dpi=100, format="png")


def _draw_axis(panel: Any, report: "EventReport", axis: "AxisReport") -> None:
  generator = torch.Generator().manual_seed(0)
  asked = axis.asked.sample((20_000,), generator=generator, device=torch.device("cpu"), dtype=torch.float64).numpy()
  drawn = axis.drawn.double().cpu().numpy()
  is_log = isinstance(axis.asked, LogUniform)
  if is_log:
    asked, drawn = np.log10(asked), np.log10(drawn[drawn > 0.0])
  lo, hi = (
    min(asked.min(), *drawn[:1], drawn.min(initial=asked.min())),
    max(asked.max(), drawn.max(initial=asked.max())),
  )
  span = {"bins": 25, "range": (lo, hi if hi > lo else lo + 1e-9), "density": True}
  panel.hist(asked, color=_GREY, **span)
  if drawn.size:
    panel.hist(drawn, color=_BLUE, histtype="step", linewidth=1.5, **span)
  colour = "black" if axis.verdict == "as asked" else "#c0392b"
  what = f"{axis.field} {axis.axis}".strip()
  panel.set_title(f"{report.name} ({report.mode})\n{what}: {axis.verdict}", fontsize=8, color=colour)
  label = {"add": "added", "scale": "factor", "absolute": "value"}[axis.operation] + f" [{axis.unit}]"
  panel.set_xlabel(f"{label}, logarithm to base 10" if is_log else label, fontsize=8)
  _plain(panel)


def _draw_mass(panel: Any, name: str, inertia: "InertiaReport") -> None:
  mass = inertia.masses[name].double().cpu().numpy()
  panel.hist(mass, bins=40, color=_BLUE)
  panel.axvline(inertia.compiled[name], color="black", linestyle=":", linewidth=1)
  panel.set_title(f"total mass of {name}", fontsize=8)
  panel.set_xlabel("[kg]", fontsize=8)
  _plain(panel)


def _draw_ellipsoids(panel: Any, name: str, inertia: "InertiaReport") -> None:
  """Ellipsoids of uniform density with a body's inertia, seen along y; the compiled one in black."""
  com, moments, quat = (part[:31].double().cpu() for part in inertia.bodies[name])
  # Semi-axes squared are five times the second moments per mass.
  squares = 5.0 * (0.5 * moments.sum(-1, keepdim=True) - moments).clamp_min(0.0)
  axes = matrix_from_quat(quat)
  shadow = ((axes * squares.unsqueeze(-2)) @ axes.mT)[:, [0, 2]][:, :, [0, 2]]
  values, vectors = torch.linalg.eigh(shadow)
  for i in reversed(range(len(com))):
    angle = float(torch.rad2deg(torch.atan2(vectors[i, 1, 1], vectors[i, 0, 1])))
    height, width = (2.0 * values[i].clamp_min(0.0).sqrt()).tolist()
    style = {"edgecolor": _BLUE, "alpha": 0.35} if i else {"edgecolor": "black", "linewidth": 1.5}
    panel.add_patch(Ellipse((float(com[i, 0]), float(com[i, 2])), width, height, angle=angle, fill=False, **style))
  panel.autoscale_view()
  panel.set_aspect("equal", adjustable="datalim")
  panel.set_title(f"{name}: inertia ellipsoids, 30 worlds", fontsize=8)
  panel.set_xlabel("x [m]; upwards z [m]", fontsize=8)
  panel.tick_params(labelsize=7)


def _plain(panel: Any) -> None:
  panel.set_yticks([])
  panel.tick_params(labelsize=7)
  panel.locator_params(axis="x", nbins=6)
  panel.spines[["top", "right", "left"]].set_visible(False)


def plot_trials(columns: dict[str, list[Any]], rewards: list[float], logarithmic: set[str], path: Path) -> None:
  """Plot trials as lines over parallel axes, one for each value and one for the reward, which is also the colour."""
  named = columns | {"reward": rewards}
  figure = Figure(figsize=(1.6 + 1.9 * len(named), 4.6), layout="constrained")
  axes = figure.subplots()
  heights = np.zeros((len(named), len(rewards)))
  for place, (name, values) in enumerate(named.items()):
    is_number = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    if is_number:
      numbers = np.array(values, dtype=float)
      scaled = np.log10(numbers) if name in logarithmic else numbers
      low, high = np.nanmin(scaled), np.nanmax(scaled)
      ticks = np.linspace(low, high, 5) if high > low else np.array([low])
      labels = [f"{10**tick if name in logarithmic else tick:.3g}" for tick in ticks]
    else:
      names = list(dict.fromkeys(map(str, values)))
      scaled = np.array([names.index(str(value)) for value in values], dtype=float)
      ticks, labels = np.arange(len(names), dtype=float), names
      low, high = 0.0, len(names) - 1.0
    span = high - low or 1.0
    heights[place] = (scaled - low) / span
    axes.axvline(place, color="black", linewidth=0.8)
    for tick, label in zip((ticks - low) / span, labels, strict=True):
      axes.annotate(f" {label}", (place, tick), fontsize=7, va="center")
  order = np.argsort(np.nan_to_num(np.array(rewards), nan=-np.inf))
  colour = colormaps["viridis"]
  for trial in order:
    axes.plot(heights[:, trial], color=colour(heights[-1, trial]), linewidth=1.3, alpha=0.8)
  axes.set_xticks(range(len(named)), list(named), fontsize=8)
  axes.set_yticks([])
  axes.set_xlim(-0.1, len(named) - 0.55)
  for side in ("left", "right", "top", "bottom"):
    axes.spines[side].set_visible(False)
  figure.savefig(path, dpi=110)
