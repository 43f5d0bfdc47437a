"""`inspect-dr TASK [flags]`: effects of the events of a task, as a table and a picture."""

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any

from mjlab_core.constraints import Limits

from mjlab.cli._command_line import CommandLine, TaskArguments, build_env, output_file, run_with_task

if TYPE_CHECKING:
  from mjlab_rl import TaskCfg


@dataclasses.dataclass(kw_only=True)
class Arguments(TaskArguments):
  """All that can be given after the task."""

  num_envs: Annotated[int, Limits(ge=2)] = 512
  """Number of environments to draw in, at least 2."""
  device: str = "cpu"
  """Device of the simulation: cpu, cuda:0, or auto for a GPU if there is one."""
  seed: int = 0
  """Seed of the draws."""
  png: str | None = None
  """Picture of distributions, total mass and inertia ellipsoids: FILE.png."""
  force: bool = False
  """Overwrite an existing picture."""


_LINE = CommandLine(
  name="inspect-dr",
  words="TASK",
  purpose=(
    "Fires every event of a task once in many environments. Prints the drawn values beside the requested range, the "
    "state that each event changes, and the total mass. Capitals mark an event that does nothing, or not what was "
    "requested."
  ),
  arguments=Arguments,
  notes="exit codes: 0 done, 1 a draw does nothing or does not match the request, 2 wrong command line\n",
)


def run(words: list[str]) -> int:
  """Inspect one task; return 1 if a draw does nothing, or not what was requested."""
  return run_with_task(_LINE, words, _inspect)


def _inspect(name: str, task: "TaskCfg[Any]", given: list[str]) -> int:
  from mjlab import environments
  from mjlab.cli._flags import parse, replaced

  wanted = parse(Arguments(env=task.env), given)
  picture = None if wanted.png is None else output_file("--png", wanted.png, ".png", force=wanted.force)
  from mjlab.inspection import inspect_events, inspect_inertia, report_text

  device = environments.resolve_device(wanted.device)
  cfg = replaced(replaced(wanted.env, ("scene", "num_envs"), wanted.num_envs), ("seed",), wanted.seed)
  env = build_env(task, cfg, device)
  try:
    reports = inspect_events(env)
    inertia = inspect_inertia(env)
    print(f"{name}: {env.num_envs} environments on {device}, one draw each")
    print(report_text(reports, inertia))
    if picture is not None:
      from mjlab.cli._plots import plot_inspection

      plot_inspection(reports, inertia, name, picture)
      print(f"wrote {picture}")
  finally:
    env.close()
  wrong = any(axis.verdict != "as asked" for report in reports for axis in report.axes)
  return 1 if wrong else 0
