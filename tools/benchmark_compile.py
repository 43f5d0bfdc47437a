"""Steps with terms as PyTorch runs them and with terms that torch.compile compiled, in turns.

  python tools/benchmark_compile.py Mjlab-Velocity-Flat-Unitree-Go1 Mjlab-Velocity-Flat-Unitree-G1 \
    --output docs/benchmarks/compile_cuda.md

Each measurement is a process of its own. "Start" is the time from the environment's constructor to the fifth step, in
which a GPU replays a recording; "cold" has an empty cache of compiled code, "warm" the one that the cold run left.
Random actions; the same solver for all.
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
from pathlib import Path
from typing import Any


def measure(task: str, args: argparse.Namespace, *, is_compiled: bool) -> dict[str, float]:
  """Return the figures of a task in this process."""
  import torch
  from benchmark_step import synchronize, timed
  from mjlab import load_task
  from mjlab_envs import ManagerBasedRlEnv

  cfg = load_task(task).env
  cfg.scene.num_envs, cfg.seed, cfg.compile_terms = args.num_envs, 1, is_compiled
  cfg.sim.solver_backend = args.solver
  began = time.perf_counter()
  env = ManagerBasedRlEnv(cfg, args.device)
  env.reset()
  action = torch.zeros(args.num_envs, env.action_manager.total_action_dim, device=env.device)

  def step() -> None:
    env.step(action.normal_())

  for _ in range(5):
    step()
  synchronize(env.device)
  found = {"start": time.perf_counter() - began}
  for _ in range(20):
    step()
  found["step"] = 1e3 * timed(step, args.steps, 3, env.device)
  if env.device.type == "cuda":
    found |= kernels(step)
  env.close()
  return found


def kernels(step: Any) -> dict[str, float]:
  """Return the number of kernels of a replayed step, and of those of torch and of compiled code."""
  import torch

  steps = 10
  with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profile:
    for _ in range(steps):
      step()
    torch.cuda.synchronize()
  count, spent = collections.Counter(), collections.Counter()
  for event in profile.events() or ():
    kind = "torch" if "at::" in event.name or event.name.startswith("triton") else "others"
    count[kind] += 1
    spent[kind] += event.device_time
  return {
    "kernels": sum(count.values()) / steps,
    "torch_kernels": count["torch"] / steps,
    "torch_ms": spent["torch"] / steps / 1e3,
  }


def in_process(task: str, args: argparse.Namespace, cache: str, *, is_compiled: bool) -> dict[str, float]:
  """Measure in a process of its own, with compiled code in the folder `cache`."""
  words = [sys.executable, __file__, task, "--num-envs", str(args.num_envs), "--device", args.device]
  words += ["--steps", str(args.steps), "--solver", args.solver, "--child", "compiled" if is_compiled else "plain"]
  env = {**os.environ, "TORCHINDUCTOR_CACHE_DIR": cache, "TRITON_CACHE_DIR": f"{cache}/triton"}
  result = subprocess.run(words, env=env, stdout=subprocess.PIPE, text=True, check=True)
  return json.loads(result.stdout.splitlines()[-1])


def row(task: str, name: str, runs: list[dict[str, float]]) -> str:
  """Return the medians of runs as a row of the table."""
  keys = ("step", "kernels", "torch_kernels", "torch_ms")
  cells = [f"{statistics.median(run[key] for run in runs):.4g}" if key in runs[0] else "" for key in keys]
  starts = [f"{runs[0]['start']:.1f}", f"{statistics.median(run['start'] for run in runs[1:]):.1f}"]
  return f"| {' | '.join((task.removeprefix('Mjlab-'), name, *cells, *starts))} |"


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("tasks", nargs="+")
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--device", default="cuda")
  parser.add_argument("--solver", default="fused", choices=("mujoco_warp", "fused", "auto"))
  parser.add_argument("--steps", type=int, default=100)
  parser.add_argument("--repeats", type=int, default=2, help="warm runs of each")
  parser.add_argument("--output", type=Path)
  parser.add_argument("--child", choices=("plain", "compiled"), help=argparse.SUPPRESS)
  args = parser.parse_args()
  if args.child:
    print(json.dumps(measure(args.tasks[0], args, is_compiled=args.child == "compiled")))
    return
  lines = [
    "| task | terms | step [ms] | kernels | kernels of torch | time in them [ms] | start, cold [s] | start, warm [s] |",
    "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |",
  ]
  for task in args.tasks:
    runs: dict[str, list[dict[str, float]]] = {"plain": [], "compiled": []}
    with tempfile.TemporaryDirectory() as cache:
      in_process(task, args, cache, is_compiled=False)  # Warp's own kernels, which both need.
      for _ in range(args.repeats + 1):
        for name, done in runs.items():
          done.append(in_process(task, args, cache, is_compiled=name == "compiled"))
    lines += [row(task, name, done) for name, done in runs.items()]
  print("\n".join(lines))
  if args.output:
    write(args, lines)


def write(args: argparse.Namespace, lines: list[str]) -> None:
  """Write the table with what it was measured on."""
  from benchmark_step import heading

  words = f"`python tools/benchmark_compile.py {' '.join(sys.argv[1:])}`"
  about = f"{args.num_envs} worlds, solver {args.solver}, random actions; medians of {args.repeats + 1} processes."
  args.output.write_text("\n\n".join((heading("Compiled terms", args.device), words, about, "\n".join(lines))) + "\n")


if __name__ == "__main__":
  main()
