"""Parts of a training iteration on a CPU: `uv run python tools/profile_training.py TASK --num-envs 256`.

Prints CPU seconds, which other work on the same cores hardly changes, and wall seconds, as medians over iterations. The
table of `docs/benchmarks/training_cpu.md` is its output.
"""

import argparse
import collections
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmark_step import heading
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import Console, RslRlVecEnvWrapper
from mjlab_rl.runner import MjlabOnPolicyRunner

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


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task")
  parser.add_argument("--num-envs", type=int, default=256)
  parser.add_argument("--iterations", type=int, default=8)
  parser.add_argument("--output", type=Path)
  args = parser.parse_args()
  task = load_task(args.task)
  task.env.scene.num_envs, task.env.seed = args.num_envs, 1
  env = ManagerBasedRlEnv(task.env, device="cpu")
  with tempfile.TemporaryDirectory() as folder:
    runner = MjlabOnPolicyRunner(RslRlVecEnvWrapper(env), task.agent, folder, console=Console("quiet"))
    rows = profile(runner, env, args.iterations)
  env.close()
  steps = args.num_envs * task.agent.num_steps_per_env
  lines = [heading(f"Parts of a training iteration: {args.task}", "cpu"), ""]
  lines += [f"{args.num_envs} worlds, {steps} steps an iteration, medians of {args.iterations - 2} iterations.", ""]
  lines += ["| part | CPU [s] | wall [s] |", "| --- | --- | --- |"]
  lines += [f"| {name} | {cpu:.3f} | {wall:.3f} |" for name, (cpu, wall) in rows.items()]
  print("\n".join(lines))
  if args.output:
    args.output.write_text("\n".join(lines) + "\n")


def profile(runner: MjlabOnPolicyRunner, env: ManagerBasedRlEnv, iterations: int) -> dict[str, Times]:
  """Return the median CPU and wall seconds of the parts of an iteration."""
  spent, samples = Spent(), []
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
    runner.learn(1)
    samples.append(dict(spent.now) | {"iteration": (time.process_time() - cpu, time.perf_counter() - wall)})
  kept = samples[2:]
  return {name: tuple(statistics.median(sample[name][i] for sample in kept) for i in (0, 1)) for name in kept[0]}


if __name__ == "__main__":
  main()
