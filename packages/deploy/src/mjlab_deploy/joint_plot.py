"""Plot of commanded and measured joints, drawn by Matplotlib."""

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mjlab_deploy.errors import DeployError

_COLUMNS = 4


def plot_joints(path: Path, joints: Sequence[str], rows: Mapping[str, np.ndarray]) -> None:
  """Draw target and position of each joint over time.

  Args:
    path: Picture to write: .png, .svg or .pdf.
    joints: Names of the joints.
    rows: "time" (rows,) [s], "position" and "target" (rows, joints), "is_policy" (rows,), as in the log of a run.

  Raises:
    DeployError: Matplotlib is not installed, or the picture cannot be written.
  """
  try:
    matplotlib: Any = importlib.import_module("matplotlib.figure")
  except ModuleNotFoundError as error:
    raise DeployError("a plot needs Matplotlib: install mjlab-deploy with its extra 'plot'") from error
  count = max(1, min(_COLUMNS, len(joints)))
  lines = -(-len(joints) // count)
  figure = matplotlib.Figure(figsize=(3.2 * count, 1.0 + 1.9 * lines), layout="constrained")
  axes = figure.subplots(lines, count, sharex=True, squeeze=False).ravel()
  time, is_policy = rows["time"], rows["is_policy"] > 0
  for i, axis in enumerate(axes):
    if i >= len(joints):
      axis.axis("off")
      continue
    axis.plot(time, rows["target"][:, i], color="tab:orange", linewidth=1.0, label="target")
    axis.plot(time, rows["position"][:, i], color="tab:blue", linewidth=1.0, label="position")
    if is_policy.any():
      axis.axvline(float(time[is_policy][0]), color="0.6", linewidth=0.8, linestyle=":")
    axis.set_title(joints[i], fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3)
  for axis in axes[max(0, len(joints) - count) : len(joints)]:
    axis.set_xlabel("time [s]", fontsize=8)
    axis.tick_params(labelbottom=True)
  handles, labels = axes[0].get_legend_handles_labels()
  figure.legend(handles, labels, loc="outside upper right", ncols=2, fontsize=8)
  figure.suptitle("Joints [rad, m]; the policy begins at the dotted line", x=0.01, ha="left", fontsize=9)
  try:
    figure.savefig(path, dpi=110)
  except (OSError, ValueError) as error:
    raise DeployError(f"{path}: {error}") from error
