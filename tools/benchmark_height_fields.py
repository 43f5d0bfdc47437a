"""Steps on rough ground with each way to collide with height fields: time and memory of the GPU.

  python tools/benchmark_height_fields.py --output docs/benchmarks/height_fields.md

All variants run one after another in one process each, with random actions and without curricula.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import torch
from benchmark_step import heading, timed

TASKS = ("Mjlab-Velocity-Rough-Unitree-G1", "Mjlab-Velocity-Rough-Unitree-Go1")
VARIANTS: dict[str, dict[str, Any]] = {
  "one thread per prism": {},
  "the same, broad phase `sap_tile`": {"broadphase": "sap_tile"},
  "the same, broad phase `sap_segmented`": {"broadphase": "sap_segmented"},
  "MuJoCo Warp's, one thread per pair": {"theirs": True},
  "the same, `ccd_iterations` 500": {"theirs": True, "ccd_iterations": 500},
  "the same, `contact_sensor_maxmatch` 500": {"theirs": True, "ccd_iterations": 500, "contact_sensor_maxmatch": 500},
}


def measure(task: str, variant: str, num_envs: int, device: str, steps: int) -> dict[str, Any]:
  """Measure one variant: milliseconds of a step, memory of the device."""
  from mjlab.registry import load_task
  from mjlab_envs import ManagerBasedRlEnv
  from mjlab_sim.warp import engine

  settings = dict(VARIANTS[variant])
  if settings.pop("theirs", False):
    module: Any = engine
    module.height_field_collisions = lambda m, d: None
  cfg = load_task(task).env
  cfg.scene.num_envs, cfg.sim.engine, cfg.seed, cfg.curriculum = num_envs, "warp", 1, {}
  for name, value in settings.items():
    setattr(cfg.sim, name, value)
  env = ManagerBasedRlEnv(cfg, device)
  env.reset()
  action = torch.zeros(num_envs, env.action_manager.total_action_dim, device=env.device)
  for _ in range(20):
    env.step(action.normal_())
  seconds = timed(lambda: env.step(action.normal_()), steps, 3, env.device)
  row = {"task": task, "variant": variant, "step_ms": 1e3 * seconds, "overflow": env.sim.overflow_report()}
  if env.device.type == "cuda":
    free, total = torch.cuda.mem_get_info()
    row["memory_gb"] = (total - free) / 1e9
  return row


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--steps", type=int, default=100)
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--tasks", nargs="+", default=TASKS)
  parser.add_argument("--only", nargs=2, metavar=("TASK", "VARIANT"), help="measure one, and print it as JSON")
  parser.add_argument("--output", type=Path)
  args = parser.parse_args()
  if args.only:
    task, variant = args.only
    print(json.dumps(measure(task, variant, args.num_envs, args.device, args.steps)))
    return
  lines = ["| task | collisions with height fields | step [ms] | memory in use [GB] |", "| --- | --- | ---: | ---: |"]
  for task in args.tasks:
    for variant in VARIANTS:
      sizes = ["--num-envs", str(args.num_envs), "--steps", str(args.steps), "--device", args.device]
      command = [sys.executable, __file__, "--only", task, variant, *sizes]
      done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
      print(done.stdout[-300:], flush=True)
      if done.returncode == 0:
        row = json.loads(done.stdout.splitlines()[-1])
        memory = f"{row['memory_gb']:.1f}" if "memory_gb" in row else ""
        lines.append(f"| {task} | {variant} | {row['step_ms']:.2f} | {memory} |")
      if args.output:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        text = heading("Collisions with height fields", args.device)
        args.output.write_text(f"{text} By `tools/benchmark_height_fields.py`.\n\n" + "\n".join(lines) + "\n")


if __name__ == "__main__":
  main()
