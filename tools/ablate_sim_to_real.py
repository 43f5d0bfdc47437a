"""Effect of each part of the sim-to-real preset on robustness: a policy trained with it, and a table of all of them.

  python tools/ablate_sim_to_real.py train pushes --seconds 80 --output OUT
  python tools/ablate_sim_to_real.py evaluate OUT

The first command trains the blind Go1 with one part of the preset, with "none" or with "all", by FastSAC. The second
takes the newest run of each part in OUT and needs no GPU: it plays all policies in the plain task, over the grid of
`evaluate_robustness.py`, and in the task of the whole preset, and writes docs/benchmarks/sim_to_real.md and .png.
"""

import argparse
from dataclasses import replace
from datetime import date
from pathlib import Path

import matplotlib as mpl
import numpy as np
import torch
from benchmark_learners import stop_after
from evaluate_robustness import COMMANDS, DELAY, FOLDER, FRICTION, PAYLOAD, PUSHES, cell, named, play
from mjlab import load_task
from mjlab.environments import resolve_device, standard_env
from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_rl import Console, TaskCfg, find_checkpoint, load_run, train, with_agent
from mjlab_velocity import VelocityEvaluation, sim_to_real
from mjlab_velocity.sim_to_real import PARTS

mpl.use("Agg")

import matplotlib.pyplot as plt

TASK = "Mjlab-Velocity-Flat-Unitree-Go1-Blind"
CHOICES = ("none", *PARTS, "all")
CONDITIONS = {
  "plain": (DELAY, 0.0, FRICTION, 0.9),
  "delay 20 ms": (DELAY, 4.0, FRICTION, 0.9),
  "delay 40 ms": (DELAY, 8.0, FRICTION, 0.9),
  "friction 0.3": (DELAY, 0.0, FRICTION, 0.3),
  "delay 40 ms, friction 0.3": (DELAY, 8.0, FRICTION, 0.3),
  "payload 5 kg": (PAYLOAD, 5.0, PUSHES, 0.0),
  "pushes 1 m/s": (PAYLOAD, 0.0, PUSHES, 1.0),
  "pushes 1.5 m/s": (PAYLOAD, 0.0, PUSHES, 1.5),
  "payload 5 kg, pushes 1.5 m/s": (PAYLOAD, 5.0, PUSHES, 1.5),
}
"""Cells of the two grids by name; each is an axis with its level, twice."""
PRESET = "the preset, pushes 1 m/s"


def preset(part: str) -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task with one part of the preset, none or all."""
  return sim_to_real(load_task(TASK), {"none": (), "all": None}.get(part, (part,)))


def train_part(args: argparse.Namespace) -> None:
  """Train a policy with one part of the preset."""
  task = with_agent(preset(args.part), "fastsac")
  task.env.scene.num_envs = args.num_envs
  task.agent.seed = task.env.seed = args.seed
  task.agent.logger = "none"
  train(
    task,
    name=TASK,
    make_env=standard_env,
    device=resolve_device(args.device),
    log_root=args.output / args.part,
    console=Console(),
    on_ready=stop_after(args.seconds),
  )


def robustness(checkpoint: Path, repeats: int) -> dict[str, tuple[float, float]]:
  """Return the share of falls and the velocity error of a policy in each condition."""
  run = load_run(checkpoint)
  learner = {"agent": run.agent, "runner": run.runner}
  plain = replace(load_task(TASK), **learner)
  grids = {}
  for down, across in ((DELAY, FRICTION), (PAYLOAD, PUSHES)):
    pushes = across[4] if across is PUSHES else (0.0,)
    levels: dict[str, tuple[float, ...]] = {axis[0]: axis[4] for axis in (down, across) if axis is not PUSHES}
    evaluator = VelocityEvaluation(grid=COMMANDS, pushes=pushes, levels=levels, repeats=repeats)
    grids[down[0]] = play(plain, checkpoint, evaluator)

  def pair(name: str) -> tuple[float, float]:
    down, a, across, b = CONDITIONS[name]
    levels = named(down, a), named(across, b)
    return cell(grids[down[0]], "fall_rate", *levels), cell(grids[down[0]], "lin_vel_rmse", *levels)

  whole = play(
    replace(preset("all"), **learner), checkpoint, VelocityEvaluation(grid=COMMANDS, pushes=(1.0,), repeats=4 * repeats)
  ).groups["all"]
  return {name: pair(name) for name in CONDITIONS} | {PRESET: (whole["fall_rate"].mean, whole["lin_vel_rmse"].mean)}


def draw(rows: dict[str, dict[str, tuple[float, float]]], picture: Path) -> None:
  """Draw falls and errors of all policies as two heat maps."""
  figure, panels = plt.subplots(1, 2, figsize=(13, 5), layout="constrained", sharey=True)
  for panel, index, title, top in zip(panels, (0, 1), ("falls", "velocity error [m/s]"), (1.0, 0.5), strict=True):
    values = np.array([[pair[index] for pair in row.values()] for row in rows.values()])
    panel.imshow(values, cmap="RdYlGn_r", vmin=0.0, vmax=top, aspect="auto")
    for i, j in np.ndindex(values.shape):
      panel.text(j, i, f"{values[i, j]:.2f}", ha="center", va="center")
    panel.set_xticks(range(values.shape[1]), list(next(iter(rows.values()))), rotation=35, ha="right")
    panel.set_yticks(range(values.shape[0]), list(rows))
    panel.set_title(title)
  panels[0].set_ylabel("part that the training had")
  figure.savefig(picture, dpi=110)


def evaluate(output: Path, repeats: int) -> None:
  """Write the table and the picture of all policies in a folder."""
  torch.set_num_threads(1)
  rows = {}
  for part in CHOICES:
    if runs := sorted((output / part).glob("*/*/manifest.json")):
      rows[part] = robustness(find_checkpoint(str(runs[-1].parent), log_root=output, experiment=""), repeats)
      print(part, rows[part], flush=True)
  draw(rows, FOLDER / "sim_to_real.png")
  names = list(next(iter(rows.values())))
  table = [f"| trained with | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
  for part, row in rows.items():
    table.append(f"| {part} | " + " | ".join(f"{fall:.2f}, {error:.2f}" for fall, error in row.values()) + " |")
  lines = [
    "# Parts of the sim-to-real preset",
    "",
    f"{date.today():%Y-%m-%d}. Policies of `{TASK}`, one seed each, trained by FastSAC with one part of the",
    "preset `mjlab_velocity.sim_to_real`, with none or with all, and played on MuJoCo's native engine:",
    f"{len(COMMANDS) * repeats} episodes of 10 s a cell. Cells are the share of episodes that end in a fall, and the",
    "root mean square error of the linear velocity [m/s]. Made by `tools/ablate_sim_to_real.py`.",
    "",
    "![Falls and errors](sim_to_real.png)",
    "",
    *table,
  ]
  text = "\n".join(lines) + "\n"
  (FOLDER / "sim_to_real.md").write_text(text, encoding="utf-8")
  print(text)


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  commands = parser.add_subparsers(dest="command", required=True)
  training = commands.add_parser("train")
  training.add_argument("part", choices=CHOICES)
  training.add_argument("--seconds", type=float, default=80.0, help="training time without start and compilation")
  training.add_argument("--seed", type=int, default=1)
  training.add_argument("--num-envs", type=int, default=4096)
  training.add_argument("--device", default="auto")
  training.add_argument("--output", type=Path, required=True)
  evaluation = commands.add_parser("evaluate")
  evaluation.add_argument("output", type=Path)
  evaluation.add_argument("--repeats", type=int, default=8)
  args = parser.parse_args()
  if args.command == "train":
    train_part(args)
  else:
    evaluate(args.output, args.repeats)


if __name__ == "__main__":
  main()
