"""Time of a step on a CPU that skips the parts whose mask is empty, as a share of one that runs all parts.

  python tools/benchmark_skipping.py Mjlab-Velocity-Flat-Unitree-Go1 --output docs/benchmarks

Two environments, of which one runs every part as a GPU does, take turns step by step, so that other programs slow both
alike. Times are CPU seconds of the process. Random actions throughout.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mjlab_envs.env
import torch
from benchmark_step import heading, make
from mjlab_core import call_where
from mjlab_managers import command_manager, event_manager

MODULES: tuple[Any, ...] = (mjlab_envs.env, command_manager, event_manager)


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task")
  parser.add_argument("--num-envs", type=int, nargs="+", default=[1, 64])
  parser.add_argument("--steps", type=int, default=200, help="steps of a repeat")
  parser.add_argument("--repeats", type=int, default=9)
  parser.add_argument("--output", type=Path, help="folder to write the table to")
  args = parser.parse_args()
  lines = [
    "| worlds | repeats | all parts [CPU ms] | without empty parts [CPU ms] | median ratio | least, greatest |",
    "| ---: | ---: | ---: | ---: | ---: | ---: |",
  ]
  for num_envs in args.num_envs:
    pairs = measure(args.task, num_envs, args.steps, args.repeats)
    times = [1e3 * statistics.median(column) for column in zip(*pairs, strict=True)]
    ratios = sorted(after / before for before, after in pairs)
    figures = [f"{value:.2f}" for value in (*times, statistics.median(ratios))]
    row = (str(num_envs), f"{args.repeats} of {args.steps} steps", *figures, f"{ratios[0]:.2f}, {ratios[-1]:.2f}")
    lines.append(f"| {' | '.join(row)} |")
    print(lines[-1], flush=True)
  if args.output:
    path = args.output / f"skipping_{args.task}_cpu.md"
    path.write_text("\n\n".join([heading(f"Skipped parts of a step: {args.task}", "cpu"), "\n".join(lines)]) + "\n")
    print(f"wrote {path}")


def measure(task: str, num_envs: int, steps: int, repeats: int) -> list[tuple[float, float]]:
  """Return the mean times [CPU s] of a step of both environments for each repeat."""
  torch.set_num_threads(1)
  envs = [make(task, num_envs, "cpu", "auto", capture=False) for _ in range(2)]
  for env in envs:
    env.reset()
  action = torch.zeros(num_envs, envs[0].action_manager.total_action_dim)
  pairs = []
  for _ in range(1 + repeats):
    total = [0.0, 0.0]
    for _ in range(steps):
      action.normal_()
      for index, (env, call) in enumerate(zip(envs, (run, call_where), strict=True)):
        for module in MODULES:
          module.call_where = call
        begin = time.process_time()
        env.step(action)
        total[index] += time.process_time() - begin
    pairs.append((total[0] / steps, total[1] / steps))
  for env in envs:
    env.close()
  # The first repeat warms up.
  return pairs[1:]


def run(mask: torch.Tensor, fn: Callable[[torch.Tensor], object], generator: torch.Generator) -> None:
  """Call a part of a step for any mask."""
  del generator
  fn(mask)


if __name__ == "__main__":
  main()
