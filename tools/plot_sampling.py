"""Starts of episodes of a training on motion clips, over time, and the share of episodes that reached the end.

  python tools/plot_sampling.py logs/g1_tracking/RUN --output docs/benchmarks/g1_sampling_gpu

Reads `progress.csv`: for each clip the share of starts that fall on each of its seconds, each clip's share of all
starts, and the success of episodes as training sees it, noise, pushes and hard starts included.
"""

import argparse
import csv
import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

PREFIX = "Metrics/motion/"


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("run", type=Path, help="a run's directory")
  parser.add_argument("--title", default="Starts of a training on clips")
  parser.add_argument("--output", type=Path, required=True, help="path without suffix; .png and .csv are written")
  args = parser.parse_args()
  with (args.run / "progress.csv").open(newline="") as file:
    rows = list(csv.DictReader(file))
  columns = {
    name.removeprefix(PREFIX): np.array([float(row[name]) for row in rows])
    for name in rows[0]
    if name.startswith(PREFIX)
  }
  clips = [name.removesuffix("/success") for name in columns if name.endswith("/success")]
  figure, axes = plt.subplots(
    2, len(clips), figsize=(3.6 * len(clips), 5.2), layout="constrained", squeeze=False, sharex=True
  )
  top = max(columns[name].max() for name in columns if re.search(r"/start_share_\d+s$", name))
  image = None
  for column, clip in enumerate(clips):
    seconds = [columns[name] for name in sorted(columns) if re.fullmatch(rf"{re.escape(clip)}/start_share_\d+s", name)]
    above, below = axes[:, column]
    image = above.imshow(
      np.array(seconds),
      aspect="auto",
      origin="lower",
      cmap="magma",
      vmin=0.0,
      vmax=top,
      extent=(0, len(rows), 0, len(seconds)),
    )
    above.set_title(clip, fontsize=10)
    for key, label in (("start_share", "share of all starts"), ("success", "followed to the end")):
      below.plot(columns[f"{clip}/{key}"], label=label, linewidth=1.4)
    below.set_ylim(0.0, 1.05)
    below.set_xlabel("iteration")
    below.grid(alpha=0.3)
    below.spines[["top", "right"]].set_visible(False)
  axes[0][0].set_ylabel("second of the clip")
  axes[1][0].legend(frameon=False, fontsize=8, loc="center right")
  if image is not None:
    figure.colorbar(image, ax=axes[0], label="share of all starts in it")
  figure.suptitle(args.title, fontsize=11)
  args.output.parent.mkdir(parents=True, exist_ok=True)
  figure.savefig(args.output.with_suffix(".png"), dpi=110)
  with args.output.with_suffix(".csv").open("w", newline="") as file:
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["iteration", *columns])
    # Every tenth row: shares change slowly.
    for i in range(0, len(rows), 10):
      writer.writerow([i, *(f"{values[i]:.4g}" for values in columns.values())])
  print(f"wrote {args.output}.png and .csv")


if __name__ == "__main__":
  main()
