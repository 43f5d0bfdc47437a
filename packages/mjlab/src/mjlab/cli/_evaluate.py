"""`evaluate TASK [flags]`: how well a policy does a task, with intervals, for people and for CI."""

import dataclasses
import itertools
import json
import sys
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjlab_core import unknown

from mjlab import making
from mjlab.cli._config_flags import flags
from mjlab.cli._errors import BuildError, UsageError
from mjlab.cli._policies import Baseline, as_trained, find_run, make_policy
from mjlab.registry import list_tasks, load_task

if TYPE_CHECKING:
  from mjlab_rl import Evaluation, Evaluator, TaskCfg


@dataclasses.dataclass(kw_only=True)
class Arguments:
  """All that can be given after the task."""

  run: str = "latest"
  """Whose policy: latest (of this task), the name or directory of a run, or a checkpoint file."""
  baseline: Baseline | None = None
  """Instead of a run: no action at all, or standard normal ones."""
  require: str | None = None
  """Thresholds, comma-separated, such as success_rate>=0.95,dance:mpkpe<=0.1; exit code 1 where one is missed."""
  output: str | None = None
  """Folder for evaluation.json, evaluation.txt and pictures; None: below the run, one for each checkpoint."""
  overwrite: bool = False
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
  if not arguments:
    raise UsageError("no task given. usage: evaluate TASK [flags]; list-envs lists the tasks.")
  name, *given = arguments
  if name in ("-h", "--help"):
    print(_general_help(), end="")
    return 0
  if name.startswith("-"):
    raise UsageError("the task comes first. usage: evaluate TASK [flags]")
  if name not in list_tasks():
    raise UsageError(unknown("task", name, list_tasks()))
  making.share_cores()
  task = load_task(name)
  wants_help = [index for index, word in enumerate(given) if word in ("-h", "--help")]
  if wants_help:
    from mjlab.cli._flag_parser import print_help

    rest = itertools.takewhile(lambda word: word not in ("-h", "--help"), given[wants_help[0] + 1 :])
    config = Arguments(eval=_evaluator(task), env=task.env)
    print_help(config, prog=f"evaluate {name}", description="", word="-".join(rest))
    return 0
  return _evaluate(name, task, given)


def _general_help() -> str:
  options = [f"  --{flag.name:<12}{flag.about}" for flag in flags(Arguments())]
  return "\n".join(
    [
      "usage: evaluate TASK [flags]\n\nPlays fixed scenarios with a policy and says how well it does, with intervals.",
      "Exit codes: 0 done, 1 a threshold was missed or it failed, 2 wrong usage.\n\nflags:",
      *(textwrap.fill(option, 100, subsequent_indent=" " * 16) for option in options),
      "  --eval.PATH   Any setting of the task's evaluation, e.g. --eval.seed 3.",
      "  --env.PATH    Any value of the environment.",
      "  --help WORD   After a task: its flags, all or those whose name contains WORD.\n",
    ]
  )


def _evaluator(task: "TaskCfg[Any]") -> "Evaluator":
  from mjlab_rl import ReturnEvaluation

  return task.evaluator if task.evaluator is not None else ReturnEvaluation()


def _evaluate(name: str, task: "TaskCfg[Any]", given: list[str]) -> int:
  from mjlab_rl import Console, Threshold

  from mjlab.cli._flag_parser import parse

  wanted = parse(Arguments(eval=_evaluator(task), env=task.env), given)
  thresholds = [Threshold.parse(text) for text in (wanted.require or "").split(",") if text.strip()]
  console = Console("quiet" if wanted.quiet else "normal")
  checkpoint = None
  if wanted.baseline is None:
    checkpoint = find_run(wanted.run, log_root=wanted.log_root, name=name, task=task)
    task = as_trained(checkpoint, name, task, console)
    # Once more, upon the configuration of the run.
    wanted = parse(Arguments(eval=_evaluator(task), env=task.env), given)
  folder = _folder(wanted, checkpoint)
  device = making.resolve_device(wanted.device)
  evaluator = wanted.eval
  try:
    cfg = evaluator.configure(wanted.env)
    env = (task.make_env or making.standard_env)(cfg, device=device)
  except (ValueError, OSError) as error:
    raise BuildError(str(error)) from error
  try:
    policy, what = make_policy(task, env, checkpoint, wanted.baseline, device)
    console.say(f"{name}: {what}, {env.num_envs} episodes on {device}")
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


def _folder(wanted: Arguments, checkpoint: Path | None) -> Path | None:
  if wanted.output is not None:
    folder = Path(wanted.output)
  elif checkpoint is not None:
    folder = checkpoint.parent / "evaluation" / checkpoint.stem
  else:
    return None
  if (folder / "evaluation.json").exists() and not wanted.overwrite:
    raise UsageError(f"{folder} has an evaluation already: --overwrite replaces it, --output puts this one elsewhere")
  return folder


def _show(step: int, left: int, total: int) -> None:
  if sys.stderr.isatty() and (step % 10 == 0 or left == 0):
    print(f"\rstep {step}: {total - left} of {total} episodes over", end="\n" if left == 0 else "", file=sys.stderr)
    sys.stderr.flush()


def _write(folder: Path, evaluation: "Evaluation", about: dict[str, Any]) -> None:
  from mjlab_rl.manifest import package_versions

  from mjlab.cli._evaluation_plot import plot_curves, plot_groups

  folder.mkdir(parents=True, exist_ok=True)
  (folder / "evaluation.txt").write_text(evaluation.table() + "\n", encoding="utf-8")
  plot_groups(evaluation, folder / "groups.png")
  if evaluation.curves:
    plot_curves(evaluation, folder / "curves.png")
  data = {**about, "versions": package_versions(), **evaluation.to_json()}
  # Last, and whole or not at all: where it is, the rest is.
  temporary = folder / ".evaluation.json.tmp"
  temporary.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
  temporary.replace(folder / "evaluation.json")
