"""Learning of two processes with half the environments each, against one process with all, for several seeds.

`uv run python tools/compare_ranks.py --output docs/benchmarks/ranks_cpu` (ten minutes on two cores)

Writes OUTPUT.csv with the reward of the episodes that end in each iteration, OUTPUT.png with the curves, and OUTPUT.md
with the iteration at which each run passes half of the final reward, and its final reward (mean of the last ten
iterations). `Train/mean_reward` would not do: it is that of the last hundred episodes of each process, which reach
further back with fewer environments.
"""

import argparse
import contextlib
import csv
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from mjlab import environments, load_task
from mjlab_rl import Console, train
from mjlab_rl.processes.ranks import Ranks

COLOURS = {1: "#c46a1b", 2: "#1b6ca8"}


def train_all(wanted: argparse.Namespace) -> None:
  """Train every seed as one process of the launch; the folder of each run has its name."""
  ranks = Ranks.launched()
  with ranks.joined("cpu"):
    for seed in wanted.seeds:
      task = load_task(wanted.task)
      task.env.scene.num_envs = wanted.num_envs // ranks.world_size
      task.env.seed = task.agent.seed = seed
      task.agent.max_iterations, task.agent.save_interval, task.agent.logger = wanted.iterations, 10**6, "none"
      folder = wanted.into / f"{ranks.world_size}_{seed}"
      train(
        task,
        name=wanted.task,
        make_env=environments.standard_env,
        log_root=folder,
        console=Console("quiet"),
        rank_timeout=None,
      )


def curves(logs: Path, seeds: list[int]) -> dict[tuple[int, int], np.ndarray]:
  """Return the reward of each iteration's episodes [1/s] by number of processes and seed."""
  found = {}
  for processes in (1, 2):
    for seed in seeds:
      (path,) = (logs / f"{processes}_{seed}").glob("*/*/progress.csv")
      with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
      terms = [name for name in rows[0] if name.startswith("Episode_Reward/")]
      found[processes, seed] = np.array([sum(float(row[name] or "nan") for name in terms) for row in rows])
  return found


def draw(found: dict[tuple[int, int], np.ndarray], title: str, path: Path) -> None:
  import matplotlib.pyplot as plt

  figure, axes = plt.subplots(figsize=(7.5, 4), layout="constrained")
  for (processes, seed), curve in found.items():
    name = f"{processes} process{'es' * (processes > 1)}" if seed == min(seed for _, seed in found) else None
    axes.plot(curve, color=COLOURS[processes], linestyle="-" if processes == 1 else "--", linewidth=1.2, label=name)
  axes.set(title=title, xlabel="iteration", ylabel="reward of the iteration's episodes [1/s]")
  axes.grid(alpha=0.3)
  axes.legend()
  figure.savefig(path, dpi=110)


def write(found: dict[tuple[int, int], np.ndarray], wanted: argparse.Namespace) -> None:
  """Write the table, the picture and the summary."""
  with wanted.output.with_suffix(".csv").open("w", newline="") as file:
    writer = csv.writer(file)
    writer.writerow(["processes", "seed", "iteration", "reward"])
    writer.writerows((*key, i, f"{reward:.4g}") for key, curve in found.items() for i, reward in enumerate(curve))
  draw(found, f"{wanted.task}, {wanted.num_envs} environments in all", wanted.output.with_suffix(".png"))
  half = 0.5 * np.mean([curve[-10:].mean() for curve in found.values()])
  lines = ["| processes | environments of each | seed | passes half of the final reward at iteration | final reward |"]
  lines += ["|---:|---:|---:|---:|---:|"]
  means: dict[int, list[float]] = {1: [], 2: []}
  for (processes, seed), curve in found.items():
    passed = int(np.argmax(curve >= half))
    means[processes].append(passed)
    each = wanted.num_envs // processes
    lines.append(f"| {processes} | {each} | {seed} | {passed} | {curve[-10:].mean():.2f} |")
  one, two = (np.array(means[processes]) for processes in (1, 2))
  lines += [
    "",
    f"One process passes half after {one.mean():.1f} iterations, with a standard deviation of {one.std(ddof=1):.1f}",
  ]
  lines[-1] += f" over seeds; two processes after {two.mean():.1f}, with {two.std(ddof=1):.1f}."
  head = f"# Two processes and one\n\n{wanted.task} on a CPU, {wanted.num_envs} environments in all.\n\n"
  wanted.output.with_suffix(".md").write_text(head + "\n".join(lines) + f"\n\n![Curves]({wanted.output.name}.png)\n")
  print("\n".join(lines))


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--task", default="Mjlab-Cartpole-Swingup")
  parser.add_argument("--num-envs", type=int, default=256, help="environments of all processes together")
  parser.add_argument("--iterations", type=int, default=60)
  parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
  parser.add_argument("--output", type=Path, help="path without suffix")
  parser.add_argument("--into", type=Path, help=argparse.SUPPRESS)
  wanted = parser.parse_args()
  if wanted.into is not None:
    train_all(wanted)
    return
  if wanted.output is None:
    parser.error("--output is missing")
  with contextlib.ExitStack() as stack:
    logs = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    for processes in ("1", "2"):
      launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", processes]
      subprocess.run([*launch, __file__, *sys.argv[1:], "--into", logs], check=True)
    found = curves(logs, wanted.seeds)
  write(found, wanted)


if __name__ == "__main__":
  main()
