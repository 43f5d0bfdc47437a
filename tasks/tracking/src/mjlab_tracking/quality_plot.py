"""The quality of a clip as a picture."""

import os
from pathlib import Path

import torch

from mjlab_tracking.quality import LIMITS, QualityReport


def plot_quality(report: QualityReport, path: str | os.PathLike[str]) -> None:
  """Draw every check over time, with its limits, as a PNG that appears whole or not at all."""
  from matplotlib.figure import Figure

  colors = {"ok": "tab:green", "warning": "tab:orange", "error": "tab:red"}
  motion = report.motion
  time = (torch.arange(motion.num_frames) / motion.rate).numpy()
  figure = Figure(figsize=(10, 1.5 * len(report.findings) + 0.6), layout="constrained")
  axes = figure.subplots(len(report.findings), 1, sharex=True)
  for axis, finding in zip(axes, report.findings, strict=True):
    limit, values = LIMITS[finding.check], report.series[finding.check].numpy()
    axis.plot(time, values, color=colors[finding.severity], linewidth=1.0)
    top = max(1.15 * float(values.max()), 1.3 * limit.warning, 0.25 * limit.error)
    axis.set_ylim(0.0, top)
    for level, style in ((limit.warning, ":"), (limit.error, "--")):
      if 0.0 < level <= top:
        axis.axhline(level, color="0.4", linestyle=style, linewidth=0.8)
    axis.set_ylabel(f"{finding.check}\n[{limit.unit}]", fontsize=8)
    axis.tick_params(labelsize=7)
    where = f", {finding.where}" if finding.where else ""
    text = f"{limit.about}: {finding.severity}, worst {finding.worst:.3g} {limit.unit} at {finding.time:.2f} s{where}"
    axis.set_title(text, fontsize=8, loc="left", pad=2)
  axes[-1].set_xlabel("time [s]", fontsize=8)
  figure.suptitle(f"{motion.name} ({motion.rate:g} Hz, {motion.duration:.1f} s)", fontsize=10)
  path = Path(path)
  path.parent.mkdir(parents=True, exist_ok=True)
  temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
  try:
    figure.savefig(temporary, dpi=80, format="png")
    temporary.replace(path)
  finally:
    temporary.unlink(missing_ok=True)
