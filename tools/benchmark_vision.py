"""Cost of cameras: environment steps and images per second, and the share of rendering in a step.

  python tools/benchmark_vision.py Mjlab-Lift-Cube-Yam-Depth --num-envs 512 4096 --device cuda --output docs/benchmarks

Random actions, the training environment, its camera "wrist_camera" drawn in every step; `rendering` is the renderer's
own calls within the step. With `--learn N` each size also trains for N iterations, and the last one is timed.
"""

import argparse
import csv
import json
import tempfile
from pathlib import Path
from typing import Any

import torch
from benchmark_step import heading, make, timed
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import Console, train
from stage_timing import time_methods


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("tasks", nargs="+")
  parser.add_argument("--num-envs", type=int, nargs="+", default=[512, 1024, 2048, 4096])
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--steps", type=int, default=50)
  parser.add_argument("--learn", type=int, default=0, metavar="N", help="iterations of training for each size")
  parser.add_argument("--output", type=Path, help="folder to write the table to")
  args = parser.parse_args()
  rows = []
  for task in args.tasks:
    for num_envs in args.num_envs:
      row = measure(task, num_envs, args.device, args.steps)
      if args.learn:
        row |= learn(task, num_envs, args.device, args.learn)
      rows.append(row)
      print(json.dumps(row), flush=True)
  if args.output:
    args.output.mkdir(parents=True, exist_ok=True)
    lines = ["| " + " | ".join(rows[0]) + " |", "|" + " --- |" * len(rows[0])]
    lines += ["| " + " | ".join(str(value) for value in row.values()) + " |" for row in rows]
    path = args.output / f"vision_{args.device.split(':')[0]}.md"
    path.write_text(heading("Cost of cameras", args.device) + "\n\n" + "\n".join(lines) + "\n")
    print(f"wrote {path}")


def measure(task: str, num_envs: int, device: str, steps: int) -> dict[str, Any]:
  """Measure a step, and rendering in it."""
  env = make(task, num_envs, device, "auto", capture=True)
  env.reset()
  action = torch.zeros(num_envs, env.action_manager.total_action_dim, device=env.device)

  def step() -> None:
    env.step(action.normal_())

  for _ in range(10):
    step()
  total = 1e3 * timed(step, steps, 3, env.device)
  camera = env.scene["wrist_camera"]
  render = time_methods(env, camera._renderer, {"render": "rendering"}, step, steps)["rendering"]
  env.close()
  return {
    "task": task,
    "worlds": num_envs,
    "pixels": f"{camera.width} x {camera.height}",
    "step_ms": round(total, 3),
    "rendering_ms": round(render, 3),
    "rendering_share": round(render / total, 2),
    "images_per_s": round(1e3 * num_envs / total),
  }


def learn(task: str, num_envs: int, device: str, iterations: int) -> dict[str, Any]:
  """Environment steps per second of the last iteration of a short training, and its times."""
  cfg = load_task(task)
  cfg.env.scene.num_envs = num_envs
  cfg.agent.max_iterations, cfg.agent.logger = iterations, "none"
  with tempfile.TemporaryDirectory() as folder:
    run = train(
      cfg,
      name=task,
      make_env=ManagerBasedRlEnv,
      log_root=Path(folder),
      device=device,
      console=Console("quiet"),
    )
    assert run.directory is not None
    with (run.directory / "progress.csv").open(newline="") as file:
      last = list(csv.DictReader(file))[-1]
  return {
    "collect_s": round(float(last["Perf/collection_time"]), 3),
    "learn_s": round(float(last["Perf/learning_time"]), 3),
    "trained_steps_per_s": round(float(last["Perf/total_fps"])),
  }


if __name__ == "__main__":
  main()
