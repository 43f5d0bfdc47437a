"""Time of an environment step, its share of physics, and its host syncs.

  python tools/benchmark_step.py Mjlab-Velocity-Flat-Unitree-Go1 --num-envs 4096 --device cuda --output docs/benchmarks

Random actions throughout, so that worlds keep ending and being reset.
"""

import argparse
import json
import os
import statistics
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from stage_timing import ENGINE_CALLS, time_methods


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task")
  parser.add_argument("--num-envs", type=int, nargs="+", default=[4096])
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--engine", choices=("auto", "native", "warp"), nargs="+", default=["auto"])
  parser.add_argument("--steps", type=int, default=200)
  parser.add_argument("--repeats", type=int, default=5)
  parser.add_argument("--eager", action="store_true", help="also time the same step without graphs (GPU)")
  parser.add_argument("--output", type=Path, help="folder to write the table to")
  args = parser.parse_args()
  rows = []
  for num_envs in args.num_envs:
    for engine in args.engine:
      rows.append(measure(args.task, num_envs, args.device, engine, args.steps, args.repeats, capture=True))
      print(json.dumps(rows[-1]), flush=True)
      if args.eager:
        rows.append(measure(args.task, num_envs, args.device, engine, 20, 3, capture=False))
        print(json.dumps(rows[-1]), flush=True)
  if args.output:
    write(args.output, args.task, args.device, rows)


def make(task: str, num_envs: int, device: str, engine: str, capture: bool):
  """Build the task's training environment."""
  from mjlab.registry import load_task
  from mjlab_envs import ManagerBasedRlEnv

  cfg = load_task(task).env
  cfg.scene.num_envs = num_envs
  cfg.sim.engine = engine
  cfg.sim.capture = capture
  # Robots that fall would go down a level of the terrain after each episode, and steps would get faster and faster.
  cfg.curriculum = {}
  cfg.seed = 1
  return ManagerBasedRlEnv(cfg, device)


def measure(
  task: str, num_envs: int, device: str, engine: str, steps: int, repeats: int, *, capture: bool
) -> dict[str, Any]:
  """Medians over repeats of `steps` steps each."""
  begin = time.perf_counter()
  env = make(task, num_envs, device, engine, capture)
  env.reset()
  action = torch.zeros(num_envs, env.action_manager.total_action_dim, device=env.device)

  def step() -> None:
    env.step(action.normal_())

  for _ in range(20):
    step()
  synchronize(env.device)
  ready = time.perf_counter() - begin
  total = timed(step, steps, repeats, env.device)

  row = {
    "task": task,
    "worlds": num_envs,
    "device": str(env.device.type),
    "engine": env.sim.engine,
    "captured": env.is_captured,
    "step_ms": round(1e3 * total, 3),
    "env_steps_per_s": round(num_envs / total),
    "ready_s": round(ready, 1),
  }
  if env.device.type == "cuda":
    row["graphs"] = env.num_graphs
    row["host_syncs"] = count_syncs(step)
  if env.device.type == "cpu" or env.is_captured:
    physics = sum(time_methods(env, env.sim._engine, ENGINE_CALLS, step, min(steps, 50)).values())
    row["physics_ms"] = round(physics, 3)
    row["physics_share"] = round(1e-3 * physics / total, 2)
  row["overflow"] = env.sim.overflow_report()
  env.close()
  return row


def timed(fn, steps: int, repeats: int, device: torch.device) -> float:
  """Seconds of one call: median over repeats of the mean over `steps` calls."""
  for _ in range(3):
    fn()
  samples = []
  for _ in range(repeats):
    synchronize(device)
    begin = time.perf_counter()
    for _ in range(steps):
      fn()
    synchronize(device)
    samples.append((time.perf_counter() - begin) / steps)
  return statistics.median(samples)


def count_syncs(step) -> int:
  """Host syncs of twenty steps; torch raises at the first, so any is reported as at least one."""
  torch.cuda.set_sync_debug_mode("error")
  try:
    for _ in range(20):
      step()
  except RuntimeError as error:
    print(f"a step synchronises: {error}")
    return 1
  finally:
    torch.cuda.set_sync_debug_mode("default")
  return 0


def synchronize(device: torch.device) -> None:
  if device.type == "cuda":
    torch.cuda.synchronize(device)


def heading(title: str, device: str) -> str:
  """Title, date, hardware and versions of a table."""
  hardware = torch.cuda.get_device_name() if device.startswith("cuda") else f"{os.cpu_count()} CPU cores"
  versions = ", ".join(f"{name} {version(name)}" for name in ("mujoco", "mujoco-warp", "warp-lang", "torch"))
  return f"# {title}\n\n{time.strftime('%Y-%m-%d')}, {hardware}, {versions}."


def write(folder: Path, task: str, device: str, rows: list[dict[str, Any]]) -> None:
  """Return the rows as a Markdown table."""
  folder.mkdir(parents=True, exist_ok=True)
  columns = [name for name in rows[0] if name not in ("task", "overflow")]
  lines = ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
  lines += ["| " + " | ".join(str(row.get(name, "")) for name in columns) + " |" for row in rows]
  path = folder / f"step_{task}_{device.split(':')[0]}.md"
  path.write_text(heading(f"Step time: {task}", device) + "\n\n" + "\n".join(lines) + "\n")
  print(f"wrote {path}")


if __name__ == "__main__":
  main()
