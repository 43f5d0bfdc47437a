"""`evaluate TASK [flags]`: how well a policy does a task, with intervals, for people and for CI."""

import dataclasses
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjlab import making
from mjlab.cli._errors import UsageError, building
from mjlab.cli._policies import Agent, find_policy, make_policy, without_teacher
from mjlab.cli._task_command import build_env, run_with_task

if TYPE_CHECKING:
  from mjlab_rl import Evaluation, Evaluator, TaskCfg

_PURPOSE = "Plays fixed scenarios with a policy and says how well it does, with 95 % intervals."
_MORE = """\
  --eval.PATH       Any setting of the task's evaluation, e.g. --eval.seed 3.

exit codes: 0 done, 1 a threshold was missed or it failed, 2 wrong usage."""


@dataclasses.dataclass(kw_only=True)
class Arguments:
  """All that can be given after the task."""

  checkpoint: str = "latest"
  """What to judge: latest (the newest run of this task), the name or directory of a run, a checkpoint, or an exported
  policy (.onnx)."""
  agent: Agent = "trained"
  """Who acts: a trained policy, nobody, or chance."""
  require: str | None = None
  """Thresholds, comma-separated, such as success_rate>=0.95,dance:mpkpe<=0.1; exit code 1 where one is missed."""
  output: str | None = None
  """Folder for evaluation.json, evaluation.txt and pictures; None: below the run, one for each checkpoint."""
  force: bool = False
  """Replace an evaluation that is there."""
  device: str = "auto"
  """Where to simulate: cpu, cuda:0, or auto for a GPU where there is one."""
  log_root: str = "logs"
  """Folder of all runs."""
  quiet: bool = False
  """Show no progress."""
  traceback: bool = False
  """Show where an error came from."""
  eval: Any = None
  """Settings of the evaluation."""
  env: Any = None
  """Configuration of the environment."""


def run(arguments: list[str]) -> int:
  """Evaluate; returns the exit code."""
  return run_with_task(
    "evaluate",
    arguments,
    _evaluate,
    Arguments,
    purpose=_PURPOSE,
    configs=lambda task: {"eval": _evaluator(task), "env": task.env},
    more=_MORE,
  )


def _evaluator(task: "TaskCfg[Any]") -> "Evaluator":
  from mjlab_rl import ReturnEvaluation

  return task.evaluator if task.evaluator is not None else ReturnEvaluation()


def _evaluate(name: str, task: "TaskCfg[Any]", given: list[str]) -> int:
  from mjlab_core import seed_everything
  from mjlab_rl import EvaluationError, Threshold

  from mjlab.cli._flag_parser import parse

  wanted = parse(Arguments(eval=_evaluator(task), env=task.env), given)
  try:
    thresholds = [Threshold.parse(text) for text in wanted.require.split(",")] if wanted.require is not None else []
  except EvaluationError as error:
    raise UsageError(f"--require: {error}") from error
  source, parts = find_policy(wanted, name, task)
  # Once more, upon the configuration of the run.
  wanted = parse(Arguments(eval=_evaluator(task), env=parts.env), given)
  folder = _folder(wanted, source)
  device = making.resolve_device(wanted.device)
  evaluator = wanted.eval
  worlds, unasked = wanted.env.scene.num_envs, parts.env.scene.num_envs
  with building():
    cfg = evaluator.configure(wanted.env)
  if worlds not in (unasked, cfg.scene.num_envs):
    raise UsageError("--env.scene.num-envs: an evaluation plays one episode in each world; --help eval says how many")
  env = build_env(parts, without_teacher(cfg, parts.agent), device)
  try:
    policy = make_policy(wanted.agent, source, env, parts)
    what = f"{wanted.agent} actions" if source is None else str(source)
    if not wanted.quiet:
      print(f"{name}: {what}, {env.num_envs} episodes on {device}", flush=True)
    # Chance is to be the same chance each time.
    seed_everything(getattr(evaluator, "seed", 0))
    evaluation = evaluator.run(env, policy, None if wanted.quiet else _show)
  finally:
    env.close()
  print(evaluation.table())
  if folder is not None:
    _write(folder, evaluation, {"task": name, "policy": what, "device": device, "command": ["evaluate", name, *given]})
    print(f"wrote {folder}")
  outcomes = [threshold.check(evaluation) for threshold in thresholds]
  for _, line in outcomes:
    print(line)
  return int(not all(reached for reached, _ in outcomes))


def _folder(wanted: Arguments, source: Path | None) -> Path | None:
  if wanted.output is not None:
    folder = Path(wanted.output)
  elif source is not None:
    folder = source.parent / "evaluation" / source.stem
  else:
    return None
  if (folder / "evaluation.json").exists() and not wanted.force:
    raise UsageError(f"{folder} has an evaluation already: --force replaces it, --output puts this one elsewhere")
  # Before the work and not after it.
  folder.mkdir(parents=True, exist_ok=True)
  return folder


def _show(step: int, left: int, total: int) -> None:
  text = f"step {step}: {total - left} of {total} episodes over"
  if sys.stderr.isatty() and (step % 10 == 0 or left == 0):
    print(f"\r{text}", end="\n" if left == 0 else "", file=sys.stderr, flush=True)
  elif step % 100 == 0:
    print(text, file=sys.stderr, flush=True)


def _write(folder: Path, evaluation: "Evaluation", about: dict[str, Any]) -> None:
  from mjlab_rl.manifest import package_versions

  from mjlab.cli._evaluation_plot import plot_curves, plot_groups

  (folder / "evaluation.txt").write_text(evaluation.table() + "\n", encoding="utf-8")
  plot_groups(evaluation, folder / "groups.png")
  if evaluation.curves:
    plot_curves(evaluation, folder / "curves.png")
  data = {**about, "versions": package_versions(), **evaluation.to_json()}
  # Last, and whole or not at all: where it is, the rest is.
  temporary = folder / ".evaluation.json.tmp"
  temporary.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
  temporary.replace(folder / "evaluation.json")
