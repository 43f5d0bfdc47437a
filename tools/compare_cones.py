r"""Learning with pyramidal against elliptic friction cones: a table of trained runs.

  python tools/compare_cones.py logs/go1_velocity/A logs/go1_velocity/B ... --output docs/benchmarks/cones.md

A run is a directory of `train`; its manifest has its cones and its seed. Rewards and times come from its
`progress.csv`. Falls, slip and successes are measured in MuJoCo C (the native engine) with elliptic cones and an
impratio of 10, whatever the run was trained with, on the scenarios of `evaluate`. All runs are of one task.
"""

import argparse
import csv
import statistics
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from benchmark_step import heading
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import CheckpointPolicy, find_checkpoint, load_run

CURVE = (100, 200, 300, 460)
"""Iterations at which rewards are shown, means of five."""


METRICS = {
  "fall_rate": "falls [share]",
  "lin_vel_rmse": "velocity error [m/s]",
  "cost_of_transport": "cost of transport",
  "success_rate": "successes [share]",
  "time_to_success": "time to success [s]",
  "drop_rate": "drops [share]",
}
"""Figures of an evaluation with their heads; a task has some of them."""


class SlipMeter:
  """Policy that measures the slip of feet in the step before each of its actions.

  Args:
    policy: the policy.
    env: environment of a velocity task.
  """

  def __init__(self, policy: CheckpointPolicy, env: ManagerBasedRlEnv) -> None:
    self._policy, self._env = policy, env
    term = env.cfg.rewards["foot_slip"]
    assert term is not None
    self._feet, self._sensor = term.params["feet"], term.params["sensor"]
    self._columns = [env.scene["robot"].site_names.index(name) for name in self._feet.site_names]
    self.squares = torch.zeros((), dtype=torch.float64)
    self.contacts = torch.zeros((), dtype=torch.float64)

  def __call__(self, observations: Mapping[str, Any]) -> torch.Tensor:
    velocity = self._env.scene["robot"].data.site_lin_vel_w[:, self._columns, :2]
    touches = self._env.scene[self._sensor].data.found > 0
    self.squares += (velocity.square().sum(-1) * touches).sum()
    self.contacts += touches.sum()
    return self._policy(observations)

  def reset(self, dones: torch.Tensor | None) -> None:
    self._policy.reset(dones)


def evaluate(run: Path, repeats: int) -> dict[str, float]:
  """Return the figures of an evaluation with elliptic cones by their heads."""
  trained = load_run(run)
  task = load_task(trained.task)
  evaluator: Any = task.evaluator
  if hasattr(evaluator, "repeats"):
    evaluator.repeats = repeats
  cfg = evaluator.configure(task.env)
  cfg.sim.engine, cfg.sim.cone, cfg.sim.impratio = "native", "elliptic", 10.0
  with ManagerBasedRlEnv(cfg, device="cpu") as env:
    policy = CheckpointPolicy(env, trained.agent, trained.runner)
    policy.load(find_checkpoint(str(run), log_root=run.parent, experiment=""))
    meter = SlipMeter(policy, env) if "foot_slip" in cfg.rewards else None
    means = {name: interval.mean for name, interval in evaluator.run(env, meter or policy).groups["all"].items()}
  found = {head: means[name] for name, head in METRICS.items() if name in means}
  if meter is not None:
    found["slip [m/s]"] = float((meter.squares / meter.contacts).sqrt())
  return found


def read(run: Path, repeats: int) -> tuple[str, str, dict[str, float]]:
  """Return the cones of a run, its seed, and its figures by their heads."""
  trained = load_run(run)
  sim: Any = trained.env.sim
  with (run / "progress.csv").open(newline="", encoding="utf-8") as file:
    rows = [{name: float(value) for name, value in row.items() if value} for row in csv.DictReader(file)]
  found: dict[str, float] = {}
  for iteration in CURVE:
    near = [row for row in rows if abs(row["iteration"] - iteration) <= 2 and "Train/mean_reward" in row]
    if near:
      found[f"reward at {iteration}"] = statistics.fmean(row["Train/mean_reward"] for row in near)
  found["training [s]"] = rows[-1]["elapsed"]
  found["1000 steps/s"] = 1e-3 * statistics.median(row["Perf/total_fps"] for row in rows)
  return f"{sim.cone}, impratio {sim.impratio:g}", str(trained.seed), found | evaluate(run, repeats)


def table(runs: list[tuple[str, str, dict[str, float]]]) -> list[str]:
  """Return one row a run, and one with the means of each kind of cones."""
  heads = list(dict.fromkeys(head for *_, found in runs for head in found))
  lines = [f"| cones | seed | {' | '.join(heads)} |", "| --- | --- |" + " ---: |" * len(heads)]
  for cones in dict.fromkeys(run[0] for run in runs):
    own = [run for run in runs if run[0] == cones]
    known = {head: [found[head] for *_, found in own if head in found] for head in heads}
    means = {head: statistics.fmean(values) for head, values in known.items() if values}
    for _, seed, found in [*own, (cones, "mean", means)]:
      cells = [f"{found[head]:.3g}" if head in found else "" for head in heads]
      lines.append(f"| {cones} | {seed} | {' | '.join(cells)} |")
  return lines


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("runs", nargs="+", type=Path)
  parser.add_argument("--repeats", type=int, default=8, help="episodes of each command and push of a walking robot")
  parser.add_argument("--output", type=Path)
  args = parser.parse_args()
  torch.set_num_threads(1)
  lines = table([read(run, args.repeats) for run in args.runs])
  print("\n".join(lines))
  if args.output:
    about = (
      "Rewards are means of five iterations. Evaluated in MuJoCo C with elliptic cones and an impratio of 10, on the\n"
      "scenarios of `evaluate`. Slip is the root mean square speed of feet in contact. By `tools/compare_cones.py`."
    )
    args.output.write_text("\n\n".join((heading("Friction cones", "cpu"), about, "\n".join(lines))) + "\n")


if __name__ == "__main__":
  main()
