"""Students of a cartpole policy that observe less than their teacher: difference in actions, and returns.

  uv run python tools/benchmark_distillation.py --output docs/benchmarks/distillation_cpu

Trains a teacher of Mjlab-Cartpole-Swingup, or takes --teacher, then students of it, and plays 100 whole episodes with
every one. Writes a table and a picture, in about half an hour on a CPU.
"""

import argparse
import copy
import csv
import tempfile
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab_managers import ObservationGroupCfg
from mjlab_rl import (
  CheckpointPolicy,
  Console,
  Evaluation,
  RslRlDistillationRunnerCfg,
  RslRlModelCfg,
  TaskCfg,
  load_run,
  train,
)
from mjlab_rl.runs.manifest import package_versions

TASK = "Mjlab-Cartpole-Swingup"
WORLDS = 256
TEACHER_ITERATIONS, STUDENT_ITERATIONS = 300, 1000
PLACES = ("cart_pos", "pole_angle")
HIDDEN = (64, 64)
STUDENTS: dict[str, tuple[str, RslRlModelCfg]] = {
  "all": ("teacher", RslRlModelCfg(hidden_dims=HIDDEN)),
  "places": ("places", RslRlModelCfg(hidden_dims=HIDDEN)),
  "places, GRU": ("places", RslRlModelCfg(hidden_dims=HIDDEN, rnn_type="gru", rnn_hidden_dim=64)),
  "places, LSTM": ("places", RslRlModelCfg(hidden_dims=HIDDEN, rnn_type="lstm", rnn_hidden_dim=64)),
}


def environment() -> ManagerBasedRlEnvCfg:
  """Swing-up with what the teacher sees, and beside it where cart and pole are, without their velocities."""
  cfg = load_task(TASK).env
  cfg.scene.num_envs = WORLDS
  seen = cfg.observations.pop("critic")
  cfg.observations["teacher"] = seen
  terms = {name: copy.deepcopy(seen.terms[name]) for name in PLACES}
  cfg.observations["places"] = ObservationGroupCfg(terms=terms)
  return cfg


def student(sees: str, model: RslRlModelCfg) -> RslRlDistillationRunnerCfg:
  agent = RslRlDistillationRunnerCfg(max_iterations=STUDENT_ITERATIONS, num_steps_per_env=32, logger="none")
  agent.obs_groups = {"student": (sees,), "teacher": ("teacher",)}
  agent.student = replace(model, distribution_cfg=agent.student.distribution_cfg)
  return agent


def trained(env: ManagerBasedRlEnvCfg, agent: Any, folder: Path, teacher: Path | None = None) -> Path:
  """Return the last checkpoint."""
  task = TaskCfg(env=env, agent=agent)
  console = Console("quiet")
  run = train(task, name=TASK, make_env=ManagerBasedRlEnv, log_root=folder, teacher=teacher, console=console)
  assert run.checkpoint is not None
  return run.checkpoint


def judged(checkpoint: Path) -> Evaluation:
  """100 whole episodes of a checkpoint's mean actions."""
  manifest, evaluator = load_run(checkpoint), load_task(TASK).evaluator
  assert evaluator is not None
  with ManagerBasedRlEnv(evaluator.configure(manifest.env), device="cpu") as env:
    policy = CheckpointPolicy(env, manifest.agent)
    policy.load(checkpoint)
    return evaluator.run(env, policy)


def column(checkpoint: Path, name: str) -> list[float]:
  with (checkpoint.parent / "progress.csv").open(newline="") as file:
    return [float(row[name]) for row in csv.DictReader(file)]


def row(name: str, checkpoint: Path, difference: str = "-") -> str:
  metrics = judged(checkpoint).groups["all"]
  cells = [
    f"{metrics[key].mean:.3g} ({metrics[key].low:.3g} .. {metrics[key].high:.3g})" for key in ("return", "upright")
  ]
  return f"| {name} | {column(checkpoint, 'elapsed')[-1]:.0f} | {difference} | {' | '.join(cells)} |"


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--output", type=Path, required=True, help="path without suffix; .md and .png are written")
  parser.add_argument("--teacher", type=Path, help="checkpoint of a run of the task, in place of a new one")
  args = parser.parse_args()
  torch.set_num_threads(1)
  folder = Path(tempfile.mkdtemp())
  teacher = args.teacher
  if teacher is None:
    task = load_task(TASK)
    task.env.scene.num_envs = WORLDS
    task.agent.max_iterations, task.agent.logger = TEACHER_ITERATIONS, "none"
    teacher = trained(task.env, task.agent, folder)
  rows = [row("the teacher", teacher)]
  print(rows[-1], flush=True)
  figure, axis = plt.subplots(figsize=(6.0, 3.6), layout="constrained")
  for name, (sees, model) in STUDENTS.items():
    checkpoint = trained(environment(), student(sees, model), folder, teacher)
    losses = np.array(column(checkpoint, "Loss/behavior"))
    rows.append(row(name, checkpoint, f"{losses[0]:.3g}, {losses[-20:].mean():.3g}"))
    print(rows[-1], flush=True)
    # Means of 10 iterations.
    axis.semilogy(np.arange(5, len(losses), 10), losses.reshape(-1, 10).mean(1), label=name, linewidth=1.4)
  axis.set_xlabel("iteration")
  axis.set_title("mean squared difference to the teacher's action")
  axis.legend(title="the student sees")
  args.output.parent.mkdir(parents=True, exist_ok=True)
  figure.savefig(args.output.with_suffix(".png"), dpi=110)
  versions = package_versions()
  text = f"""# Students beside their teacher: cartpole swing-up

By `uv run python tools/benchmark_distillation.py`, on two shared cores of a CPU with other work on them,
{date.today().isoformat()}, MuJoCo {versions["mujoco"]}, torch {versions["torch"]}, rsl-rl {versions["rsl-rl-lib"]}.
{WORLDS} worlds, 32 steps an iteration; the teacher learned for {TEACHER_ITERATIONS} iterations, each student from it
for {STUDENT_ITERATIONS}. "Places" are the cart's position and the pole's angle, without the velocities that the teacher
sees. The difference is that of actions, squared. Return (1000 at most) and share of time upright are of 100 whole
episodes with each, means with 95 % bootstrap intervals; episodes begin almost alike. One run of each.

| sees | training [s] | difference to the teacher: first iteration, last 20 | return | upright |
|---|---|---|---|---|
{chr(10).join(rows)}

![Difference to the teacher by iteration]({args.output.name}.png)
"""
  args.output.with_suffix(".md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
  main()
