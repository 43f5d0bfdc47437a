"""Weak and strong scaling of training on the devices of this host.

`uv run python tools/benchmark_scaling.py [--gpus 1,2,4] [--tasks T ...] [--num-envs 4096]`

Each row is one run of `train --gpus N`, measured over the second half of its iterations. Weak: the environments per
GPU are constant. Strong: those of all GPUs together are, for the first task. Without a GPU it checks itself with one
and two processes of a small task. It prints a Markdown table.
"""

import argparse
import csv
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch

TRAIN = "import sys; from mjlab.cli import train; sys.exit(train())"
TASKS = ["Mjlab-Velocity-Flat-Unitree-G1", "Mjlab-Velocity-Rough-Unitree-Go1"]


def measured(task: str, count: int, num_envs: int, iterations: int, device: str) -> dict[str, float]:
  """Train with `count` processes; return steps per second, times of an iteration, and the start-up time [s]."""
  with tempfile.TemporaryDirectory() as folder:
    flags = {"device": device, "gpus": str(count), "env.scene.num-envs": num_envs, "agent.max-iterations": iterations}
    flags |= {"agent.save-interval": 10**6, "agent.logger": "none", "log-root": folder}
    words = [word for name, value in flags.items() for word in (f"--{name}", str(value))]
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", TRAIN, task, *words], check=True, stdout=subprocess.DEVNULL)
    whole = time.perf_counter() - began
    (progress,) = Path(folder).glob("*/*/progress.csv")
    rows = list(csv.DictReader(progress.open()))
  half = rows[len(rows) // 2 :]
  mean = {
    name: sum(float(row[f"Perf/{name}"]) for row in half) / len(half) for name in ("collection_time", "learning_time")
  }
  steps = float(rows[-1]["total_steps"]) / len(rows)
  return {
    "rate": steps / sum(mean.values()),
    "collect": mean["collection_time"],
    "learn": mean["learning_time"],
    "start": whole - float(rows[-1]["elapsed"]),
  }


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  found = torch.cuda.device_count()
  counts = [count for count in (1, 2, 4, 8) if count <= found] or [1, 2]
  parser.add_argument("--gpus", default=",".join(map(str, counts)))
  parser.add_argument("--tasks", nargs="+", default=TASKS if found else ["Mjlab-Cartpole-Balance"])
  parser.add_argument("--num-envs", type=int, default=4096 if found else 16)
  parser.add_argument("--iterations", type=int, default=24 if found else 6)
  wanted = parser.parse_args()
  device = "cuda" if found else "cpu"
  where = f"{found} x {torch.cuda.get_device_name()}" if found else "CPU, which checks the script and measures nothing"
  print(f"{where}, torch {torch.__version__}, {wanted.iterations} iterations per run\n")
  columns = ["scaling", "task", "GPUs", "environments per GPU", "steps/s", "of linear", "rollout [s]", "update [s]"]
  columns += ["start [s]"]
  print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}", flush=True)
  runs = [("weak", task, int(count), wanted.num_envs) for task in wanted.tasks for count in wanted.gpus.split(",")]
  runs += [
    ("strong", task, count, envs // count) for _, task, count, envs in runs if task == wanted.tasks[0] and count > 1
  ]
  alone: dict[str, float] = {}
  for kind, task, count, num_envs in runs:
    row = measured(task, count, num_envs, wanted.iterations, device)
    linear = row["rate"] / count / alone.setdefault(task, row["rate"] / count)
    figures = [f"{row['rate']:,.0f}", f"{linear:.2f}", *(f"{row[name]:.3f}" for name in ("collect", "learn"))]
    print(f"| {kind} | {task} | {count} | {num_envs} | {' | '.join(figures)} | {row['start']:.1f} |", flush=True)


if __name__ == "__main__":
  main()
