"""`evaluate TASK [flags]`: statistics of a policy with confidence intervals, for people and for CI."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mjlab_core
import mjlab_rl
from mjlab_core import AtomicWrite, UsageError
from mjlab_rl.runs.manifest import package_versions

from mjlab import environments
from mjlab.cli.shared._command_line import (
  CommandLine,
  TaskArguments,
  TaskLine,
  as_usage,
  beside,
  building,
  output_file,
)
from mjlab.cli.shared._policies import PolicyArguments, find_policy
from mjlab.cli.shared._progress import progress_bar


@dataclass(kw_only=True)
class Arguments(PolicyArguments, TaskArguments):
  """Arguments after the task."""

  require: str | None = None
  """Thresholds, comma-separated, such as success_rate>=0.95,dance:mpkpe<=0.1; exit code 1 if one is missed."""
  grid: str | None = None
  """Values of randomised quantities by event, such as "actuator_delay=0,4,8 foot_friction_slide=0.3,1.2"; every
  combination is played. For evaluations that have levels, such as those of velocity tasks."""
  output: str | None = None
  """Folder for evaluation.json, evaluation.txt and pictures; None: evaluation beside the policy; of a policy
  that ships, in this folder."""
  force: bool = False
  """Replace an existing evaluation."""
  quiet: bool = False
  """Show no progress."""
  eval: Any = None
  """Settings of the evaluation."""


@CommandLine(
  "evaluate",
  "TASK",
  Arguments,
  notes="""\
  --eval.PATH VALUE         Any setting of the task's evaluation, e.g. --eval.seed 3.

exit codes: 0 done, 1 a threshold was missed or the command failed, 2 wrong command line
""",
)
def run(wanted: Arguments, line: TaskLine) -> int:
  """Play fixed scenarios with a policy, and print statistics with 95 % confidence intervals."""
  with as_usage("--require"):
    texts = [] if wanted.require is None else wanted.require.split(",")
    thresholds = [mjlab_rl.Threshold.parse(text) for text in texts]
  found = find_policy(wanted, line)
  # Again, with the configuration of the run as the default.
  wanted = line.parse(env=found.parts.env)
  folder = _folder(wanted, found.source)
  device = environments.resolve_device(wanted.device)
  cfg = _configured(wanted, line.name, found.parts.env.scene.num_envs)
  with found.acting(cfg, device) as (env, policy):
    if not wanted.quiet:
      print(f"{line.name}: {found}, {env.num_envs} episodes on {device}", flush=True)
    evaluation, broken = _played(wanted, env, policy)
  print(evaluation.table())
  if folder is not None:
    about = {
      "task": line.name,
      "policy": str(found),
      "device": device,
      "command": ["evaluate", line.name, *line.given],
      "nonfinite_actions": broken,
    }
    _write(folder, evaluation, about)
    print(f"wrote {folder}")
  outcomes = [threshold.check(evaluation) for threshold in thresholds]
  for _, text in outcomes:
    print(text)
  if broken:
    print(f"failed: {broken} actions of the policy were NaN or infinite, which the environment takes for zero")
  return int(broken > 0 or not all(reached for reached, _ in outcomes))


def _configured(wanted: Arguments, name: str, default: int) -> Any:
  """Return the environment configuration of an evaluation of `name`, whose run has `default` environments."""
  evaluator, num_envs = wanted.eval, wanted.env.scene.num_envs
  if wanted.grid is not None:
    if not hasattr(evaluator, "levels"):
      raise UsageError(f"--grid: {type(evaluator).__name__}, the evaluation of {name}, has no levels")
    evaluator.levels = {**evaluator.levels, **_levels(wanted.grid)}
  with building():
    cfg = evaluator.configure(wanted.env)
  if num_envs not in (default, cfg.scene.num_envs):
    raise UsageError("--env.scene.num-envs: an evaluation plays one episode in each environment; see --help eval")
  return cfg


def _played(wanted: Arguments, env: Any, policy: "mjlab_rl.Policy") -> "tuple[mjlab_rl.Evaluation, int]":
  """Return the evaluation of a policy, and the number of its actions that were not finite."""
  policy = mjlab_rl.FinitePolicy(policy)
  # Random actions are the same in every evaluation.
  mjlab_core.seed_everything(getattr(wanted.eval, "seed", 0))
  if wanted.quiet:
    return wanted.eval.run(env, policy, None), policy.num_broken
  steps = int(env.max_episode_length)
  with progress_bar("evaluating", steps) as show_progress:

    def show(step: int, left: int, total: int) -> None:
      # All episodes may end before their longest time.
      show_progress(steps if left == 0 else min(step, steps), f"{total - left} of {total} episodes done")

    return wanted.eval.run(env, policy, show), policy.num_broken


def _levels(text: str) -> dict[str, tuple[float, ...]]:
  levels = {}
  for word in text.split():
    event, _, values = word.partition("=")
    try:
      levels[event] = tuple(float(value) for value in values.split(","))
    except ValueError:
      raise UsageError(f"--grid: {word!r} is not of the form EVENT=NUMBER,NUMBER,...") from None
  return levels


def _folder(wanted: Arguments, source: Path | None) -> Path | None:
  if wanted.output is not None:
    folder = Path(wanted.output)
  elif source is not None:
    folder = beside(source, "evaluation") / source.stem
  else:
    return None
  output_file("--output", folder / "evaluation.json", force=wanted.force)
  # Fails before the work if the folder cannot be made.
  folder.mkdir(parents=True, exist_ok=True)
  return folder


def _write(folder: Path, evaluation: "mjlab_rl.Evaluation", about: dict[str, Any]) -> None:
  from mjlab.cli.shared._plots import plot_curves, plot_groups

  (folder / "evaluation.txt").write_text(evaluation.table() + "\n", encoding="utf-8")
  plot_groups(evaluation, folder / "groups.png")
  if evaluation.curves:
    plot_curves(evaluation, folder / "curves.png")
  data = {**about, "versions": package_versions(), **evaluation.to_json()}
  # Last: if this file exists, the others do.
  with AtomicWrite(folder / "evaluation.json") as path:
    path.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
