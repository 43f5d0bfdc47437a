"""Curves of learners over wall time, from `tools/benchmark_learners.py`, beside committed curves of PPO.

  uv run python tools/plot_learners.py "fastsac, seed 1=OUT/g1_fastsac.npz" "PPO=docs/benchmarks/g1_flat_gpu.csv" \
    --title "G1 on flat ground" --output docs/benchmarks/learners_g1_flat

A .csv may hold several runs; FILE#RUN names one, else it is the first. Writes OUTPUT.csv and OUTPUT.png, and prints a
row for each curve: when means of five iterations meet the target, and where the curve ends.
"""

import argparse
import csv
import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from benchmark_learners import COLUMNS, WALKS, seconds_to_target, smooth

LABELS = {
  "episode_length": "mean episode length [steps]",
  "error_vel_xy": "velocity error [m/s]",
  "error_body_pos": "mean error of body positions [m]",
  "reward": "mean reward per episode",
}


def read(path: Path, run: str) -> dict[str, np.ndarray]:
  """Return the curve of an .npz file, or of a run in a .csv file."""
  if path.suffix == ".npz":
    with np.load(path, allow_pickle=False) as file:
      return {name: file[name] for name in file.files}
  with path.open(newline="") as file:
    rows = list(csv.DictReader(file))
  rows = [row for row in rows if row["run"] == (run or rows[0]["run"])]
  return {name: np.array([float(row.get(name) or "nan") for row in rows]) for name in COLUMNS}


def main() -> None:
  """Write the picture and the curves."""
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("curves", nargs="+", metavar="NAME=FILE")
  parser.add_argument("--title", required=True)
  parser.add_argument("--target", nargs="+", default=WALKS, help="conditions, as in benchmark_learners.py")
  parser.add_argument("--seconds", type=float, default=500.0, help="end of the picture")
  parser.add_argument("--output", type=Path, required=True, help="path without suffix")
  args = parser.parse_args()
  bounds = {name: float(bound) for name, bound in (re.split("[<>]", condition) for condition in args.target)}
  shown = [name for name in LABELS if name in bounds or name in ("episode_length", "reward")]
  figure, axes = plt.subplots(1, len(shown), figsize=(4 * len(shown), 4.0), layout="constrained")
  colors = plt.get_cmap("tab10" if len(args.curves) <= 10 else "tab20")(range(len(args.curves)))
  for axis in axes:
    axis.set_prop_cycle(color=colors)
  lines = [["run", *COLUMNS]]
  for text in args.curves:
    name, _, path = text.rpartition("=")
    path, _, run = path.partition("#")
    found = read(Path(path), run)
    # About a hundred iterations are enough for a picture.
    rows = range(0, len(found["steps"]), 1 + len(found["steps"]) // 150)
    lines += [[name, *(f"{found[column][row]:.5g}" for column in COLUMNS)] for row in rows]
    for axis, column in zip(axes, shown, strict=True):
      axis.plot(found["seconds"], smooth(found[column]), label=name)
      axis.set(xlabel="wall time of training [s]", ylabel=LABELS[column], xlim=(0, args.seconds))
    reached = seconds_to_target(found, args.target)
    last = [f"{smooth(found[column])[-1]:.3g}" for column in shown]
    time = "-" if reached is None else f"{reached:.0f}"
    print(f"| {name} | {time} | {found['seconds'][-1]:.0f} | {found['steps'][-1] / 1e6:.1f} | {' | '.join(last)} |")
  for axis, column in zip(axes, shown, strict=True):
    if column in bounds:
      axis.axhline(bounds[column], color="0.7", linewidth=1)
    if column.startswith("error"):
      axis.set_ylim(0, 4 * bounds[column])
  figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
  figure.suptitle(args.title)
  figure.savefig(args.output.with_suffix(".png"), dpi=100)
  with args.output.with_suffix(".csv").open("w", newline="") as file:
    csv.writer(file, lineterminator="\n").writerows(lines)


if __name__ == "__main__":
  main()
