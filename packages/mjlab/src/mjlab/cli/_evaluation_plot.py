"""Pictures of an evaluation."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

if TYPE_CHECKING:
  from mjlab_rl import Evaluation

MOST_GROUPS = 30
"""How many groups a picture shows."""


def plot_groups(evaluation: "Evaluation", path: Path) -> None:
  """Each metric of each group as a point with its interval."""
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
  """Each curve over the seconds of an episode, one line for each group."""
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
