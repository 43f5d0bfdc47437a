"""`inspect-dr TASK [flags]`: effects of the events of a task, as a table and a picture."""

from dataclasses import dataclass
from typing import Annotated

from mjlab_core.constraints import Limits

from mjlab import environments
from mjlab.cli.shared._command_line import CommandLine, TaskArguments, TaskLine, built_env, output_file


@dataclass(kw_only=True)
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


@CommandLine(
  "inspect-dr",
  "TASK",
  Arguments,
  notes="exit codes: 0 done, 1 a draw does nothing or does not match the request, 2 wrong command line\n",
)
def run(wanted: Arguments, line: TaskLine) -> int:
  """Fire every event of a task once in many environments.

  Print the drawn values beside the requested range, the state that each event changes, and the total mass. Capitals
  mark an event that does nothing, or not what was requested.
  """
  picture = None if wanted.png is None else output_file("--png", wanted.png, ".png", force=wanted.force)
  from mjlab.inspection import inspect_events, inspect_inertia, report_text

  device = environments.resolve_device(wanted.device)
  wanted.env.scene.num_envs, wanted.env.seed = wanted.num_envs, wanted.seed
  with built_env(line.task, wanted.env, device) as env:
    reports = inspect_events(env)
    inertia = inspect_inertia(env)
    print(f"{line.name}: {env.num_envs} environments on {device}, one draw each")
    print(report_text(reports, inertia))
    if picture is not None:
      from mjlab.cli.shared._plots import plot_inspection

      plot_inspection(reports, inertia, line.name, picture)
      print(f"wrote {picture}")
  return int(any(axis.verdict.isupper() for report in reports for axis in report.axes))
