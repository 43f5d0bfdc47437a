r"""Learning curves of runs as a picture and a small CSV, with the reference's published points beside them.

  python tools/plot_learning.py gpu=logs/go1_velocity/RUN cpu=logs/go1_velocity/OTHER --title "Go1 flat" \
    --reference 100:56 200:62 460:87 --output docs/benchmarks/go1_flat

A run is a directory with `progress.csv`, as `train` writes it, under the name it is to have in the picture; a run that
was resumed is its directories, separated by commas. `--show` names further columns of `progress.csv` to draw. With
`--against steps` curves are drawn over environment steps, which compares runs with different numbers of worlds.
"""

import argparse
import csv
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

COLUMNS = {
  "iteration": "iteration",
  "steps": "total_steps",
  "seconds": "elapsed",
  "reward": "Train/mean_reward",
  "episode_length": "Train/mean_episode_length",
  "error_vel_xy": "Metrics/twist/error_vel_xy",
  "error_vel_yaw": "Metrics/twist/error_vel_yaw",
  "terrain_level": "Curriculum/terrain_levels/mean",
  "steps_per_second": "Perf/total_fps",
  "collect_s": "Perf/collection_time",
  "learn_s": "Perf/learning_time",
}
PANELS = (
  ("reward", "mean reward per episode"),
  ("episode_length", "mean episode length [steps]"),
  ("error_vel_xy", "velocity error [m/s]"),
  ("error_vel_yaw", "turning error [rad/s]"),
  ("terrain_level", "mean terrain level"),
)


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("runs", nargs="+", metavar="NAME=DIRECTORY")
  parser.add_argument("--title", default="Learning curve")
  parser.add_argument("--against", choices=("iteration", "steps", "seconds"), default="iteration")
  parser.add_argument("--reference", nargs="*", default=[], metavar="ITERATION:REWARD")
  parser.add_argument("--show", nargs="*", default=[], metavar="COLUMN", help="more columns of progress.csv to draw")
  parser.add_argument("--every", type=int, default=1, metavar="N", help="write one iteration in N to the CSV")
  parser.add_argument("--output", type=Path, required=True, help="path without suffix; .png and .csv are written")
  args = parser.parse_args()
  columns = COLUMNS | {column.rsplit("/", 1)[-1]: column for column in args.show}
  runs = {name: read(parts.split(","), columns) for name, parts in (run.split("=", 1) for run in args.runs)}
  panels = [*PANELS, *((key, key.replace("_", " ")) for key in columns if key not in COLUMNS)]
  panels = [(key, label) for key, label in panels if any(key in row for rows in runs.values() for row in rows)]
  figure, axes = plt.subplots(1, len(panels), figsize=(4.2 * len(panels), 3.4), layout="constrained", squeeze=False)
  for axis, (key, label) in zip(axes[0], panels, strict=True):
    for number, (name, rows) in enumerate(runs.items()):
      drawn = [(row[args.against], row[key]) for row in rows if key in row]
      if drawn:
        x, y = np.array(drawn).T
        axis.plot(x, smooth(y), label=name, color=f"C{number}", linewidth=1.4)
        axis.plot(x, y, color=f"C{number}", alpha=0.25, linewidth=0.7, zorder=1)
    if key == "reward" and args.reference:
      points = [tuple(float(x) for x in point.split(":")) for point in args.reference]
      axis.scatter(*zip(*points, strict=True), marker="x", color="black", zorder=3, label="reference, mjlab 1.6.0")
    axis.set_xlabel("environment steps" if args.against == "steps" else args.against)
    axis.set_title(label, fontsize=10)
    axis.grid(alpha=0.3)
    axis.spines[["top", "right"]].set_visible(False)
  axes[0][0].legend(frameon=False, fontsize=8)
  figure.suptitle(args.title, fontsize=11)
  args.output.parent.mkdir(parents=True, exist_ok=True)
  figure.savefig(args.output.with_suffix(".png"), dpi=130)
  write(args.output.with_suffix(".csv"), {name: rows[:: args.every] for name, rows in runs.items()}, columns)
  print(f"wrote {args.output}.png and .csv")


def smooth(values: np.ndarray) -> np.ndarray:
  """Means over a fortieth of the curve, of what there is of it at the ends; raw values are drawn faintly behind."""
  window = np.ones(max(1, len(values) // 40))
  return np.convolve(values, window, "same") / np.convolve(np.ones_like(values), window, "same")


def read(directories: list[str], columns: dict[str, str]) -> list[dict[str, float]]:
  """Return the rows of a run under their short names, without missing values."""
  rows = []
  for directory in directories:
    with (Path(directory) / "progress.csv").open(newline="") as file:
      rows += csv.DictReader(file)
  return [{short: float(row[column]) for short, column in columns.items() if row.get(column)} for row in rows]


def write(path: Path, runs: dict[str, list[dict[str, float]]], columns: dict[str, str]) -> None:
  """One line for each row of each run."""
  with path.open("w", newline="") as file:
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["run", *columns])
    for name, rows in runs.items():
      for row in rows:
        writer.writerow([name, *(f"{row[column]:.5g}" if column in row else "" for column in columns)])


if __name__ == "__main__":
  main()
