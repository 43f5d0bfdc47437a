"""Parts of a training iteration on a CPU, beside steps alone.

  uv run python tools/profile_training.py Mjlab-Velocity-Flat-Unitree-Go1 --output docs/benchmarks/training_cpu.md

Prints CPU seconds, which other work on the same cores hardly changes, and wall seconds, as medians over iterations.
Each line of `--threads` is a process of its own: torch's threads in updates, and "sleep" or "spin" for what they do
while they wait. `train` has all cores and lets them sleep.
"""

import argparse
import collections
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

Times = tuple[float, float]


class Spent:
  """CPU and wall seconds spent in named calls."""

  def __init__(self) -> None:
    self.now: dict[str, Times] = collections.defaultdict(lambda: (0.0, 0.0))

  def watch(self, owner: Any, method: str, name: str) -> None:
    """Count the calls of a method under a name."""
    original: Callable[..., Any] = getattr(owner, method)

    def call(*args: Any, **kwargs: Any) -> Any:
      cpu, wall = time.process_time(), time.perf_counter()
      try:
        return original(*args, **kwargs)
      finally:
        before = self.now[name]
        self.now[name] = (before[0] + time.process_time() - cpu, before[1] + time.perf_counter() - wall)

    setattr(owner, method, call)


def measure(task: str, num_envs: int, iterations: int) -> dict[str, Times]:
  """Return the medians of steps alone and of the parts of an iteration in this process."""
  from mjlab import load_task
  from mjlab_envs import ManagerBasedRlEnv
  from mjlab_rl import Console, MjlabOnPolicyRunner, RslRlVecEnvWrapper

  parts = load_task(task)
  parts.env.scene.num_envs, parts.env.seed = num_envs, 1
  env = ManagerBasedRlEnv(parts.env, device="cpu")
  with tempfile.TemporaryDirectory() as folder:
    runner = MjlabOnPolicyRunner(RslRlVecEnvWrapper(env), parts.agent, folder, console=Console("quiet"))
    rows = profile(runner, env, iterations)
  env.close()
  return rows


def profile(runner: Any, env: Any, iterations: int) -> dict[str, Times]:
  """Return the median CPU and wall seconds of the parts of an iteration."""
  import torch

  spent, samples = Spent(), []
  env.reset()
  action = torch.zeros(env.num_envs, env.action_manager.total_action_dim)
  engine = env.sim._engine
  for call in ("step", "forward", "reset"):
    spent.watch(engine, call, "physics")
  spent.watch(runner.env, "step", "environment steps, physics included")
  spent.watch(runner.alg, "act", "actor and critic of the rollout")
  spent.watch(runner.alg, "process_env_step", "storage")
  spent.watch(runner, "_collect", "rollout in all")
  spent.watch(runner.alg, "compute_returns", "returns")
  spent.watch(runner.alg.optimizer, "step", "optimiser")
  spent.watch(runner, "_update", "update in all")
  for _ in range(iterations):
    spent.now.clear()
    cpu, wall = time.process_time(), time.perf_counter()
    for _ in range(runner.agent_cfg.num_steps_per_env):
      env.step(action.normal_())
    alone = time.process_time() - cpu, time.perf_counter() - wall
    spent.now.clear()
    cpu, wall = time.process_time(), time.perf_counter()
    runner.learn(1)
    spent.now["as many steps with random actions, alone"] = alone
    samples.append(dict(spent.now) | {"iteration": (time.process_time() - cpu, time.perf_counter() - wall)})
  kept = samples[2:]
  return {name: tuple(statistics.median(sample[name][i] for sample in kept) for i in (0, 1)) for name in kept[0]}


def in_process(args: argparse.Namespace, setting: str) -> dict[str, Times]:
  """Measure in a process of its own with torch's threads as `setting` says, such as "2 sleep"."""
  threads, _, waiting = setting.partition(" ")
  env = {**os.environ, "OMP_NUM_THREADS": threads}
  env |= {"OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": "1000"} if waiting == "sleep" else {}
  words = [sys.executable, __file__, args.task, "--num-envs", str(args.num_envs)]
  result = subprocess.run(
    [*words, "--iterations", str(args.iterations), "--child"], env=env, stdout=subprocess.PIPE, text=True, check=True
  )
  return json.loads(result.stdout.splitlines()[-1])


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task")
  parser.add_argument("--num-envs", type=int, default=256)
  parser.add_argument("--iterations", type=int, default=8)
  parser.add_argument("--threads", nargs="+", default=["1 sleep", "2 sleep", "2 spin"])
  parser.add_argument("--output", type=Path)
  parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
  args = parser.parse_args()
  if args.child:
    print(json.dumps(measure(args.task, args.num_envs, args.iterations)))
    return
  found = {setting: in_process(args, setting) for setting in args.threads}
  heads = [f"{setting}: {unit}" for setting in found for unit in ("CPU [s]", "wall [s]")]
  lines = [f"| part | {' | '.join(heads)} |", "| --- |" + " ---: |" * len(heads)]
  for name in next(iter(found.values())):
    cells = [f"{value:.3f}" for rows in found.values() for value in rows[name]]
    lines.append(f"| {name} | {' | '.join(cells)} |")
  print("\n".join(lines))
  if args.output:
    from benchmark_step import heading

    about = f"{args.num_envs} worlds, medians of {args.iterations - 2} iterations, made by"
    words = f"`python tools/profile_training.py {' '.join(sys.argv[1:])}`."
    parts = (heading(f"Parts of a training iteration: {args.task}", "cpu"), f"{about}\n{words}", "\n".join(lines))
    args.output.write_text("\n\n".join(parts) + "\n")


if __name__ == "__main__":
  main()
