"""Cost of the NaN guard, which keeps the last states of every world, as a share of an environment step.

Two environments of one task, with and without the NaN guard, take turns. The fastest round of each counts, because
other programs disturb it least. On a CPU the calls of the guard are also timed alone, which is more precise for a small
share than a difference. Prints a row for docs/benchmarks.

  uv run python tools/benchmark_nan_guard.py Mjlab-Velocity-Flat-Unitree-Go1 --num-envs 1 64 1024
"""

import argparse
import time
from collections.abc import Callable
from unittest import mock

import torch
from mjlab.registry import load_task
from mjlab_envs import ManagerBasedRlEnv


def build(task: str, num_envs: int, device: str, *, enabled: bool) -> ManagerBasedRlEnv:
  cfg = load_task(task).env
  cfg.scene.num_envs = num_envs
  cfg.seed = 0
  cfg.sim.nan_guard.enabled = enabled
  env = ManagerBasedRlEnv(cfg, device)
  env.reset()
  return env


def seconds(env: ManagerBasedRlEnv, steps: int) -> float:
  action = torch.zeros(env.num_envs, env.action_manager.total_action_dim, device=env.device)
  if env.device.type == "cuda":
    torch.cuda.synchronize()
  start = time.perf_counter()
  for _ in range(steps):
    env.step(action)
  if env.device.type == "cuda":
    torch.cuda.synchronize()
  return (time.perf_counter() - start) / steps


def share_inside(env: ManagerBasedRlEnv, steps: int) -> float:
  """Share of a step that passes in calls of the guard; a GPU works on after they return."""
  guard, spent = env.nan_guard, 0.0

  def timed(call: Callable[..., None]) -> Callable[..., None]:
    def run(*args: object) -> None:
      nonlocal spent
      start = time.perf_counter()
      call(*args)
      spent += time.perf_counter() - start

    return run

  assert guard is not None
  with mock.patch.multiple(guard, record=timed(guard.record), keep=timed(guard.keep)):
    whole = seconds(env, steps) * steps
  return spent / whole


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task")
  parser.add_argument("--num-envs", type=int, nargs="+", default=[64])
  parser.add_argument("--steps", type=int, default=20, help="per round")
  parser.add_argument("--rounds", type=int, default=40)
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  args = parser.parse_args()
  print("| worlds | step without [ms] | step with [ms] | guard [% of a step] | timed inside [%] | memory [MB] |")
  print("|---|---|---|---|---|---|")
  for num_envs in args.num_envs:
    plain, guarded = (build(args.task, num_envs, args.device, enabled=enabled) for enabled in (False, True))
    for env in (plain, guarded):
      seconds(env, 10)
    rounds = [(seconds(plain, args.steps), seconds(guarded, args.steps)) for _ in range(args.rounds)]
    without, with_guard = (1e3 * min(times) for times in zip(*rounds, strict=True))
    inside = "-" if args.device.startswith("cuda") else f"{100 * share_inside(guarded, args.steps * args.rounds):.1f}"
    assert guarded.nan_guard is not None
    size = guarded.nan_guard.num_bytes / 1e6
    print(
      f"| {num_envs} | {without:.2f} | {with_guard:.2f} | {100 * (with_guard / without - 1.0):.1f} | {inside} |"
      f" {size:.1f} |",
      flush=True,
    )
    plain.close()
    guarded.close()


if __name__ == "__main__":
  main()
