"""Time of a PPO update, rsl-rl's own beside the recorded one, with a task's networks and mini-batches.

  uv run python tools/benchmark_update.py Mjlab-Velocity-Flat-Unitree-G1 --output docs/benchmarks/update_cuda.md

Rollouts hold random numbers, for an update takes as long with any. Both learners are timed in turns. On a CPU there is
nothing to record.
"""

import argparse
import contextlib
import io
import statistics
import sys
import time
from datetime import date
from pathlib import Path
from typing import Any

import torch
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import RslRlOnPolicyRunnerCfg
from mjlab_rl.runs.manifest import package_versions
from rsl_rl.algorithms import PPO
from rsl_rl.utils import resolve_callable
from tensordict import TensorDict

KINDS = {"rsl-rl": "rsl_rl.algorithms:PPO", "recorded": "PPO"}


def learner(task: str, kind: str, num_envs: int, device: str) -> tuple[PPO, RslRlOnPolicyRunnerCfg, TensorDict]:
  """Return a learner of a task for so many worlds, its settings, and random observations."""
  loaded = load_task(task)
  agent = loaded.agent
  assert isinstance(agent, RslRlOnPolicyRunnerCfg)
  agent.algorithm.class_name = KINDS[kind]
  loaded.env.scene.num_envs = 1
  env = ManagerBasedRlEnv(loaded.env, "cpu")
  seen: dict[str, Any] = env.get_observations()
  actions = env.action_manager.total_action_dim
  env.close()
  groups = {name for used in agent.obs_groups.values() for name in used}
  shapes = {name: (num_envs, *seen[name].shape[1:]) for name in groups}
  observations = TensorDict(
    {name: torch.randn(shape, device=device) for name, shape in shapes.items()}, [num_envs], device=device
  )
  worlds: Any = argparse.Namespace(num_envs=num_envs, num_actions=actions)
  cfg: dict[str, Any] = agent.to_rsl_rl() | {"torch_compile_mode": None, "multi_gpu": None}
  algorithm: Any = resolve_callable(cfg["algorithm"]["class_name"])
  with contextlib.redirect_stdout(io.StringIO()):
    return algorithm.construct_algorithm(observations, worlds, cfg, device), agent, observations


def time_update(alg: PPO, agent: RslRlOnPolicyRunnerCfg, observations: TensorDict) -> tuple[float, float]:
  """Return the times of the returns and of the update of one random rollout [ms]."""
  num_envs = observations.batch_size[0]
  device = observations.device
  with torch.no_grad():
    for _ in range(agent.num_steps_per_env):
      alg.act(observations)
      zeros = torch.zeros(num_envs, device=device)
      alg.process_env_step(observations, torch.randn_like(zeros), zeros, {})
  times = [clock(device)]
  with torch.no_grad():
    alg.compute_returns(observations)
  times.append(clock(device))
  alg.update()
  times.append(clock(device))
  return 1e3 * (times[1] - times[0]), 1e3 * (times[2] - times[1])


def clock(device: Any) -> float:
  """Return the time after all work [s]."""
  if torch.device(device).type == "cuda":
    torch.cuda.synchronize(device)
  return time.perf_counter()


def main() -> None:
  """Time the updates and print a table."""
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("tasks", nargs="+")
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--repeats", type=int, default=15)
  parser.add_argument("--output", type=Path, help="file to write the table to")
  args = parser.parse_args()
  lines = ["| task | learner | returns [ms] | update [ms] |", "|---|---|---:|---:|"]
  for task in args.tasks:
    parts = {kind: learner(task, kind, args.num_envs, args.device) for kind in KINDS}
    torch.set_float32_matmul_precision(parts["recorded"][1].matmul_precision)
    samples: dict[str, list[tuple[float, float]]] = {kind: [] for kind in KINDS}
    for _ in range(args.repeats + 3):
      for kind, part in parts.items():
        samples[kind].append(time_update(*part))
    for kind, values in samples.items():
      returns, update = (statistics.median(column) for column in zip(*values[3:], strict=True))
      lines.append(f"| {task} | {kind} | {returns:.1f} | {update:.1f} |")
      print(lines[-1], flush=True)
  if args.output:
    hardware = torch.cuda.get_device_name() if args.device.startswith("cuda") else "CPU"
    packages = package_versions()
    versions = ", ".join(f"{name} {packages[name]}" for name in ("torch", "rsl-rl-lib"))
    setting = f"{date.today()}, {hardware}, {args.num_envs} worlds, medians of {args.repeats}. {versions}"
    command = f"`uv run python tools/benchmark_update.py {' '.join(sys.argv[1:])}`\n"
    args.output.write_text("\n".join(["# Time of a PPO update", "", setting, "", command, *lines, ""]))


if __name__ == "__main__":
  main()
