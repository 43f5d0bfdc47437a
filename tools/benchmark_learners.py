"""Learning curve of one learner on one task, for a given time: wall time, steps, episode length, velocity error.

  uv run python tools/benchmark_learners.py Mjlab-Velocity-Flat-Unitree-G1 --agent fastsac --seconds 400 --output OUT/g1

Trains unattended, stops after the iteration that passes --seconds, and writes OUTPUT.json (settings, hardware, time to
the target), OUTPUT.npz (the curve) and OUTPUT.md (one row of a table); the run directory is beside them. The target is
an episode length of 950 steps with a velocity error below 0.3 m/s, both as means of five iterations; other tasks name
theirs, as in `--target "error_body_pos<0.03"` or `--target "reward>20"`. All other flags are those of `train`.
"""

import argparse
import csv
import json
import platform
import re
import shlex
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from mjlab import load_task
from mjlab.cli._train import Arguments
from mjlab.cli.shared._flags import parse
from mjlab.environments import resolve_device, standard_env
from mjlab_rl import Console, OffPolicyRunnerCfg, train, with_agent
from mjlab_rl.runs.manifest import package_versions

COLUMNS = {
  "seconds": "elapsed",
  "steps": "total_steps",
  "reward": "Train/mean_reward",
  "episode_length": "Train/mean_episode_length",
  "error_vel_xy": "Metrics/twist/error_vel_xy",
  "error_vel_yaw": "Metrics/twist/error_vel_yaw",
  "steps_per_second": "Perf/total_fps",
  "collect_s": "Perf/collection_time",
  "learn_s": "Perf/learning_time",
  "error_body_pos": "Episode_Metrics/error_body_pos",
}
WALKS = ("episode_length>950", "error_vel_xy<0.3")
"""Target of walking robots."""


def curve(directory: Path) -> dict[str, np.ndarray]:
  """Return the columns of progress.csv; NaN where there is no value."""
  with (directory / "progress.csv").open(newline="") as file:
    rows = list(csv.DictReader(file))
  return {name: np.array([float(row.get(column) or "nan") for row in rows]) for name, column in COLUMNS.items()}


def smooth(values: np.ndarray) -> np.ndarray:
  """Return means of up to five values that end at each."""
  return np.array(
    [np.nanmean(values[max(0, i - 4) : i + 1]) if np.isfinite(values[i]) else np.nan for i in range(len(values))]
  )


def seconds_to_target(found: dict[str, np.ndarray], target: Sequence[str] = WALKS) -> float | None:
  """Return the time at which all conditions, such as "reward>20", first hold; None if they do not."""
  good = np.ones(len(found["seconds"]), dtype=bool)
  for condition in target:
    name, sign, bound = re.split("([<>])", condition)
    good &= (smooth(found[name]) - float(bound)) * (1 if sign == ">" else -1) > 0
  return float(found["seconds"][good.argmax()]) if good.any() else None


def stop_after(
  seconds: float, target: Sequence[str] = WALKS, after_target: float = float("inf")
) -> Callable[..., Callable[[], None]]:
  """Return a watcher that ends a training with a signal, as a user would, `seconds` after the first step.

  A training that reaches its target ends `after_target` seconds later.
  """

  def watch(env: Any, directory: Path | None) -> Callable[[], None]:
    del env
    assert directory is not None
    began, steps, end, is_sent = time.monotonic(), 0, seconds, False

    def after_step() -> None:
      nonlocal steps, end, is_sent
      steps += 1
      if steps % 200 == 0 and (directory / "progress.csv").exists():
        reached = seconds_to_target(curve(directory), target)
        end = seconds if reached is None else min(seconds, reached + after_target)
      if not is_sent and time.monotonic() - began > end:
        is_sent = True
        signal.raise_signal(signal.SIGTERM)

    return after_step

  return watch


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task")
  parser.add_argument("--agent", default="ppo", help="ppo, fastsac or flashsac")
  parser.add_argument("--seconds", type=float, required=True, help="training time without start and compilation")
  parser.add_argument("--after-target", type=float, default=float("inf"), help="end so many seconds after the target")
  parser.add_argument("--target", nargs="+", default=WALKS, help="conditions on columns of the curve")
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--seed", type=int, default=1)
  parser.add_argument("--device", default="auto")
  parser.add_argument("--output", type=Path, required=True, help="path without suffix")
  args, flags = parser.parse_known_args()
  device = resolve_device(args.device)
  task = with_agent(load_task(args.task), args.agent)
  wanted = parse(Arguments(agent=task.agent, env=task.env), flags)
  task = replace(task, agent=wanted.agent, env=wanted.env)
  task.env.scene.num_envs = args.num_envs
  task.agent.seed = task.env.seed = args.seed
  task.agent.logger = "none"
  args.output.parent.mkdir(parents=True, exist_ok=True)
  began = time.monotonic()
  result = train(
    task,
    name=args.task,
    make_env=standard_env,
    device=device,
    log_root=args.output.parent / "logs",
    console=Console(),
    on_ready=stop_after(args.seconds, args.target, args.after_target),
  )
  assert result.directory is not None
  found = curve(result.directory)
  np.savez_compressed(args.output.with_suffix(".npz"), allow_pickle=False, **found)
  half = len(found["seconds"]) // 2
  step = 1e3 * (found["collect_s"] + found["learn_s"])[half:].mean() / task.agent.num_steps_per_env
  summary: dict[str, Any] = {
    "task": args.task,
    "agent": args.agent,
    "flags": shlex.join(flags),
    "seed": args.seed,
    "num_envs": args.num_envs,
    "device": torch.cuda.get_device_name(device) if device != "cpu" else platform.processor() or "cpu",
    "iterations": result.iterations,
    "wall_s": time.monotonic() - began,
    "training_s": found["seconds"][-1],
    "steps": found["steps"][-1],
    "target": list(args.target),
    "target_s": seconds_to_target(found, args.target),
    "reward": smooth(found["reward"])[-1],
    "error_body_pos": smooth(found["error_body_pos"])[-1],
    "episode_length": smooth(found["episode_length"])[-1],
    "error_vel_xy": smooth(found["error_vel_xy"])[-1],
    "error_vel_yaw": smooth(found["error_vel_yaw"])[-1],
    "ms_per_step_with_updates": step,
    "versions": package_versions(),
  }
  if isinstance(task.agent, OffPolicyRunnerCfg):
    updates = task.agent.num_steps_per_env * task.agent.algorithm.updates_per_step
    summary["ms_per_update"] = 1e3 * found["learn_s"][half:].mean() / updates
  args.output.with_suffix(".json").write_text(json.dumps(summary, indent=1, default=float) + "\n", encoding="utf-8")
  columns = (
    "task",
    "agent",
    "seed",
    "num_envs",
    "training_s",
    "steps",
    "target_s",
    "reward",
    "episode_length",
    "error_vel_xy",
    "error_vel_yaw",
    "ms_per_step_with_updates",
    "ms_per_update",
  )
  cells = [summary.get(name) for name in columns]
  shown = ["-" if cell is None else f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in cells]
  text = f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}\n| {' | '.join(shown)} |\n"
  args.output.with_suffix(".md").write_text(text, encoding="utf-8")
  print(text)


if __name__ == "__main__":
  main()
