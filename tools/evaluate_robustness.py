"""Robustness of a policy of velocities: falls and errors over delay, friction, payload, pushes, as heat map.

uv run python tools/evaluate_robustness.py packages/mjlab/src/mjlab/demo_policy/model_460.pt go1_demo_cpu

Writes docs/benchmarks/robustness_NAME.md and .png. Each cell plays the commands `COMMANDS` for 10 s, with the other
quantities as in the training of the policy. Delays are of targets, in physics steps of 5 ms.
"""

import argparse
import os
import platform
from datetime import date
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import torch
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab_rl import CheckpointPolicy, Evaluation, TaskCfg
from mjlab_velocity import VelocityEvaluation

FOLDER = Path(__file__).parents[1] / "docs" / "benchmarks"
# What a short training has seen.
COMMANDS = ((0.5, 0.0, 0.0), (0.8, 0.0, 0.0), (0.0, 0.3, 0.0), (0.3, 0.0, 0.4))
PHYSICS_MS = 5
# Two grids: event, label, unit, factor from levels to the unit, levels.
DELAY = ("actuator_delay", "delay of targets", "ms", PHYSICS_MS, (0.0, 2.0, 4.0, 6.0, 8.0))
FRICTION = ("foot_friction_slide", "friction of the feet", "", 1, (0.3, 0.6, 0.9, 1.2))
PAYLOAD = ("payload", "payload", "kg", 1, (0.0, 1.0, 2.5, 5.0))
PUSHES = ("push", "pushes every 3 s", "m/s", 1, (0.0, 0.5, 1.0, 1.5))


def play(task: TaskCfg[ManagerBasedRlEnvCfg], checkpoint: Path, evaluator: VelocityEvaluation) -> Evaluation:
  """Return the results of an evaluation of a policy."""
  with ManagerBasedRlEnv(evaluator.configure(task.env), device="cpu") as env:
    policy = CheckpointPolicy(env, task.agent, task.runner)
    policy.load(checkpoint)
    return evaluator.run(env, policy)


def cell(result: Evaluation, metric: str, one: str, other: str) -> float:
  """Return the mean of a pair of conditions, in whichever order it is named."""
  groups = result.groups
  return groups[f"{one}, {other}" if f"{one}, {other}" in groups else f"{other}, {one}"][metric].mean


def named(axis: tuple, level: float) -> str:
  return f"push {level:g} m/s" if axis[0] == "push" else f"{axis[0]} {level:g}"


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("checkpoint", type=Path)
  parser.add_argument("name")
  parser.add_argument("--task", default="Mjlab-Velocity-Flat-Unitree-Go1")
  parser.add_argument("--repeats", type=int, default=4)
  args = parser.parse_args()
  torch.set_num_threads(1)
  figure, panels = plt.subplots(2, 2, figsize=(9, 7), layout="constrained")
  lines = [
    f"# Robustness: {args.name}",
    "",
    f"{date.today():%Y-%m-%d}, `{args.task}`, {platform.machine()} CPU, {os.cpu_count()} cores, native engine. "
    f"{len(COMMANDS) * args.repeats} episodes of 10 s a cell,",
    f"made by `tools/evaluate_robustness.py {args.checkpoint.name} {args.name} --repeats {args.repeats}`. Cells are "
    "the share of episodes that end in a fall, and",
    "the root mean square error of the linear velocity [m/s].",
    "",
    f"![Heat maps](robustness_{args.name}.png)",
  ]
  for row, (down, across) in enumerate(((DELAY, FRICTION), (PAYLOAD, PUSHES))):
    pushes = across[4] if across is PUSHES else (0.0,)
    levels: dict[str, tuple[float, ...]] = {axis[0]: axis[4] for axis in (down, across) if axis is not PUSHES}
    evaluator = VelocityEvaluation(grid=COMMANDS, pushes=pushes, levels=levels, repeats=args.repeats)
    result = play(load_task(args.task), args.checkpoint, evaluator)
    tables = {}
    for column, (metric, label) in enumerate((("fall_rate", "falls"), ("lin_vel_rmse", "velocity error [m/s]"))):
      values = np.array([[cell(result, metric, named(down, a), named(across, b)) for b in across[4]] for a in down[4]])
      tables[metric] = values
      panel = panels[row, column]
      top = 1.0 if metric == "fall_rate" else 0.5
      panel.imshow(values, cmap="RdYlGn_r", vmin=0.0, vmax=top, aspect="auto")
      for i, j in np.ndindex(values.shape):
        panel.text(j, i, f"{values[i, j]:.2f}", ha="center", va="center")
      panel.set_xticks(range(len(across[4])), [f"{across[3] * value:g}" for value in across[4]])
      panel.set_yticks(range(len(down[4])), [f"{down[3] * value:g}" for value in down[4]])
      panel.set_xlabel(f"{across[1]} [{across[2]}]" if across[2] else across[1])
      panel.set_ylabel(f"{down[1]} [{down[2]}]")
      panel.set_title(label)
    unit = f" {across[2]}" if across[2] else ""
    lines += ["", f"| {down[1]} | " + " | ".join(f"{across[1]} {across[3] * b:g}{unit}" for b in across[4]) + " |"]
    lines.append("|---" * (len(across[4]) + 1) + "|")
    for i, a in enumerate(down[4]):
      pairs = zip(tables["fall_rate"][i], tables["lin_vel_rmse"][i], strict=True)
      lines.append(
        f"| {down[3] * a:g} {down[2]} | " + " | ".join(f"{fall:.2f}, {error:.2f}" for fall, error in pairs) + " |"
      )
  figure.savefig(FOLDER / f"robustness_{args.name}.png", dpi=110)
  (FOLDER / f"robustness_{args.name}.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
  print("\n".join(lines))


if __name__ == "__main__":
  main()
