"""Cost of the last observations of episodes, which off-policy learners ask for, as a share of a step.

  python tools/benchmark_final_observations.py Mjlab-Velocity-Flat-Unitree-Go1 Mjlab-Velocity-Flat-Unitree-G1 \
    --output docs/benchmarks/final_observations_cuda.md

Two environments of each task, with `capture_terminal_observations` and without, make blocks of steps in turns, under
random actions. Each pair of blocks gives a ratio; the table has its median and quartiles.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import torch
from benchmark_step import heading, synchronize
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv

COLUMNS = "| task | worlds | step without [ms] | with [ms] | additional time, median [%] | quartiles [%] |"


def stepper(task: str, num_envs: int, device: str, *, is_on: bool) -> Callable[[int], float]:
  """Return a function that makes a number of steps and returns the time of one [ms]."""
  cfg = load_task(task).env
  cfg.scene.num_envs, cfg.seed, cfg.capture_terminal_observations = num_envs, 1, is_on
  cfg.curriculum = {}  # So that both stay on the levels of the terrain where they began.
  env = ManagerBasedRlEnv(cfg, device)
  env.reset()
  action = torch.zeros(num_envs, env.action_manager.total_action_dim, device=env.device)

  def block(steps: int) -> float:
    synchronize(env.device)
    begin = time.perf_counter()
    for _ in range(steps):
      env.step(action.normal_())
    synchronize(env.device)
    return 1e3 * (time.perf_counter() - begin) / steps

  return block


def row(task: str, num_envs: int, device: str, steps: int, repeats: int) -> str:
  """Return the row of a task."""
  off, on = (stepper(task, num_envs, device, is_on=is_on) for is_on in (False, True))
  for block in (off, on):
    block(2 * steps)
  pairs = []
  for number in range(repeats):
    # The second of a pair would always have the warmer device.
    if number % 2:
      after = on(steps)
      pairs.append((off(steps), after))
    else:
      pairs.append((off(steps), on(steps)))
  ratios = [100.0 * (after / before - 1.0) for before, after in pairs]
  low, middle, high = statistics.quantiles(ratios, n=4)
  times = [statistics.median(part) for part in zip(*pairs, strict=True)]
  return f"| {task} | {num_envs} | {times[0]:.3f} | {times[1]:.3f} | {middle:+.1f} | {low:+.1f} .. {high:+.1f} |"


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("tasks", nargs="+")
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--steps", type=int, default=50, help="steps of a block")
  parser.add_argument("--repeats", type=int, default=40, help="pairs of blocks")
  parser.add_argument("--output", type=Path)
  args = parser.parse_args()
  lines = [COLUMNS, "|---|---:|---:|---:|---:|---|"]
  for task in args.tasks:
    lines.append(row(task, args.num_envs, args.device, args.steps, args.repeats))
    print(lines[-1], flush=True)
  if args.output:
    words = f"`python tools/benchmark_final_observations.py {' '.join(sys.argv[1:])}`"
    about = f"Random actions; {args.repeats} pairs of blocks of {args.steps} steps each, in turns."
    title = heading("Last observations of episodes", args.device)
    args.output.write_text("\n\n".join((title, words, about, "\n".join(lines))) + "\n", encoding="utf-8")


if __name__ == "__main__":
  main()
