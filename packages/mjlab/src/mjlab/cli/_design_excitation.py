"""`design-excitation TASK --fit PATTERN ... [flags]`: commands whose record identifies parameters of a robot well."""

from dataclasses import dataclass

from mjlab.cli._sysid import RobotArguments, print_iteration, robot_of, task_ranges
from mjlab.cli.shared._command_line import CommandLine, TaskArguments, TaskLine, output_file
from mjlab.cli.shared._progress import stop_on_ctrl_c


@dataclass(kw_only=True)
class Arguments(RobotArguments, TaskArguments):
  """All that can be given after the task."""

  joints: tuple[str, ...] = (".*",)
  """Patterns of the joints to move; the others hold their pose."""
  output: str = "excitation.csv"
  """Table of commands: time [s], and position_target/JOINT [rad or m]."""
  seconds: float = 10.0
  """Length [s]."""
  rate: float = 100.0
  """Rate of commands and of the record [Hz]."""
  highest: float = 4.0
  """Highest frequency [Hz]."""
  share: float = 0.7
  """Share of the limits that is used, of positions, velocities and efforts."""
  velocity: float = 10.0
  """Velocity limit of joints whose actuator config has none [rad/s or m/s]."""
  noise: float = 1e-3
  """Expected noise of positions [rad or m]."""
  rounds: int = 3
  """Rounds of the search; each varies the best candidate."""
  candidates: int = 6
  """Candidates of a round."""
  seed: int = 0
  """Seed of the draws."""


@CommandLine(
  "design-excitation",
  "TASK",
  Arguments,
  notes="limits are those of the model: run the commands slowly and with small --share first.\n",
)
def run(wanted: Arguments, _: TaskLine) -> int:
  """Design commands for a robot held by its base, and write them as a table.

  They are sums of sines that stay within its limits, touch nothing, and make the smallest singular value of a later
  fit large. Ctrl-C ends the search and writes the best commands so far; a second Ctrl-C writes nothing.
  """
  output = output_file("--output", wanted.output, ".csv", force=wanted.force)
  from mjlab_sysid import ExcitationCfg, design_excitation, parse_term, write_record

  names = ("seconds", "highest", "share", "velocity", "noise", "rounds", "candidates", "seed")
  cfg = ExcitationCfg(period=1.0 / wanted.rate, **{field: getattr(wanted, field) for field in names})
  terms = [parse_term(text) for text in wanted.fit]
  robot = robot_of(wanted.env, wanted)
  with stop_on_ctrl_c() as stopped:
    found = design_excitation(
      robot,
      terms,
      cfg,
      joints=wanted.joints,
      ranges=task_ranges(wanted.env),
      on_iteration=lambda seen: print_iteration(seen, "smallest singular value") or bool(stopped),
    )
  if found.stopped:
    print("stopped (Ctrl-C) before the search ended")
  print(found.summary())
  write_record(found.commands, output)
  print(f"commands: {output}")
  return 0
