"""Picture of a quality report. Needs matplotlib, the extra `plot`."""

import os

import torch
from mjlab_core.files import AtomicWrite

from mjlab_motions.quality import LIMITS, QualityReport


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
    top = max(1.15 * float(values.max()), 1.3 * limit.warning, 0.25 * limit.poor)
    axis.set_ylim(0.0, top)
    for level, style in ((limit.warning, ":"), (limit.poor, "--")):
      if 0.0 < level <= top:
        axis.axhline(level, color="0.4", linestyle=style, linewidth=0.8)
    axis.set_ylabel(f"{finding.check}\n[{limit.unit}]", fontsize=8)
    axis.tick_params(labelsize=7)
    where = f", {finding.where}" if finding.where else ""
    worst = f"score {finding.score:.2f}, worst {finding.worst:.3g} {limit.unit} at {finding.time:.2f} s{where}"
    axis.set_title(f"{limit.about}: {finding.severity}, {worst}", fontsize=8, loc="left", pad=2)
  axes[-1].set_xlabel("time [s]", fontsize=8)
  figure.suptitle(f"{motion.name} ({motion.rate:g} Hz, {motion.duration:.1f} s)", fontsize=10)
  with AtomicWrite(path) as temporary:
    figure.savefig(temporary, dpi=80, format="png")
