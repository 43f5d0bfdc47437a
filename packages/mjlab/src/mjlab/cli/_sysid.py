"""`sysid RECORD ... --task TASK --fit PATTERN ... [flags]`: fit parameters of a task's robot to its records."""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from mjlab_core.constraints import Items
from mjlab_core.errors import ConfigError
from mjlab_core.names import check_name

from mjlab import environments
from mjlab.cli.shared._command_line import CommandLine, CommonArguments, output_file
from mjlab.cli.shared._progress import stop_on_ctrl_c
from mjlab.registry import load_task

if TYPE_CHECKING:
  from mjlab_sysid import Progress, Range, Record, Robot


@dataclass(kw_only=True)
class RobotArguments(CommonArguments):
  """Flags of commands about parameters of a task's robot."""

  fit: Annotated[tuple[str, ...], Items()] = ()
  """Parameters, each FIELD[.AXIS]:PATTERN[=LO..HI][,shared]: armature:.*_calf_joint."""
  entity: str = "robot"
  """Name of the robot in the task's scene."""
  force: bool = False
  """Overwrite existing files."""
  height: float = 1.0
  """Height of the held base above the world's origin [m]."""
  floor: float | None = None
  """Height of a floor [m]; None: no floor under a held base, 0 under a free one."""


@dataclass(kw_only=True)
class Arguments(RobotArguments):
  """All that can be given after the records."""

  task: str = ""
  """Task whose robot was recorded."""
  held_out: tuple[str, ...] = ()
  """Records that are only scored."""
  output: str = "identified.json"
  """Overlay file, for --env.scene.entities.robot.overlay of any command."""
  report: str | None = None
  """Report as HTML; None: that of the overlay, with suffix .html."""
  resume: bool = False
  """Continue a fit that was ended, from its file OUTPUT.progress; the other arguments must be the same."""
  device: str = "auto"
  """Device of the rollouts: auto, cpu or cuda:0."""
  engine: Literal["auto", "native", "warp"] = "auto"
  """Physics engine; auto: MuJoCo Warp on a GPU, MuJoCo's own batch on a CPU."""
  base: Literal["held", "free"] = "held"
  """Base of the robot in the records; free needs base_position and base_orientation in them."""
  imu: str | None = None
  """Site of the IMU; None: that of the model's first gyro or accelerometer."""
  window: float = 0.3
  """Length of the windows that are rolled out, each from a measured state [s]."""
  solver: Literal["gauss-newton", "cma"] = "gauss-newton"
  """Solver; cma needs no gradient, for records full of contacts."""
  iterations: int = 40
  """Largest number of iterations of a pass."""
  max_std: float = 0.1
  """Standard deviation, in units of half the bounds' width, above which a parameter stays at its prior."""


@CommandLine(
  "sysid",
  "RECORD [RECORD ...]",
  Arguments,
  notes="""\
records are .csv, .npz or .mcap files; fields are rows of the catalogue of mjlab-dr, the actuators' stiffness, damping,
effort_limit and delay [s], and encoder_bias. Default bounds are those of the task's randomisation, or 0.25 to 4 times
the model's value.
""",
)
def run(wanted: Arguments, paths: list[str]) -> int:
  """Fit parameters of a robot to records of its commands and motion.

  Write an overlay file that any task applies, and a report. Parameters that are not identifiable are named and stay
  at their prior. Ctrl-C ends the fit and writes what was found; a second Ctrl-C writes nothing. Either can be
  continued with --resume.
  """
  output = Path(wanted.output)
  report = Path(wanted.report or output.with_suffix(".html"))
  for flag, path in (("--output", output), ("--report", report)):
    output_file(flag, path, force=wanted.force or wanted.resume)
  env = load_task(wanted.task).env
  from mjlab_sysid import IdentifyCfg, identify, parse_term, read_records, write_report

  terms = [parse_term(text) for text in wanted.fit]
  names = ("window", "solver", "iterations", "max_std", "engine")
  device = environments.resolve_device(wanted.device) if wanted.engine != "native" else "cpu"
  cfg = IdentifyCfg(device=device, **{name: getattr(wanted, name) for name in names})
  records, held_out = read_records(paths), read_records(wanted.held_out) if wanted.held_out else []
  describe_records([*records, *held_out])
  robot = robot_of(env, wanted, base=wanted.base, imu=wanted.imu)
  kept = Path(f"{output}.progress")
  with warnings.catch_warnings(record=True) as caught, stop_on_ctrl_c() as stopped:
    warnings.simplefilter("always")
    found = identify(
      robot,
      records,
      terms,
      cfg,
      held_out=held_out,
      ranges=task_ranges(env),
      on_iteration=lambda seen: print_iteration(seen, "cost") or bool(stopped),
      progress=kept,
      resume=wanted.resume,
    )
  for text in dict.fromkeys(str(entry.message) for entry in caught):
    print(f"warning: {text}")
  if found.stopped:
    print(f"stopped (Ctrl-C) before the fit converged; the same command with --resume continues it from {kept}")
  print(found.summary())
  found.save(output)
  print(f"overlay: {output}; apply it with --env.scene.entities.{wanted.entity}.overlay {output}")
  write_report(found, report)
  print(f"report: {report}")
  return 0


def print_iteration(seen: "Progress", value: str) -> None:
  """Print a line about an iteration of a fit or a design, whose cost is called `value`."""
  print(f"{seen.stage}: iteration {seen.iteration}, {value} {seen.cost:.5g}", flush=True)


def describe_records(records: "list[Record]") -> None:
  """Print a description of each record."""
  for record in records:
    print(f"{record.source}: {record.num_rows} rows every {record.period:g} s, joints {', '.join(record.joints)}")
    if record.ignored:
      print(f"not read: {', '.join(record.ignored)}")


def robot_of(
  env: Any, wanted: RobotArguments, *, base: Literal["held", "free"] = "held", imu: str | None = None
) -> "Robot":
  """Return the robot of a task's environment, as its records are explained.

  Raises:
    UnknownNameError: The scene has no such entity.
    ConfigError: The entity has no actuator models.
  """
  from mjlab_sysid import robot_on_ground, robot_on_stand

  entity, floor = wanted.entity, wanted.floor
  built = env.scene.entities[check_name("entity", entity, env.scene.entities)].build(entity)
  if not built.is_actuated:
    raise ConfigError(f"entity '{entity}' has no actuator models, so nothing commands it")
  cfgs = built.actuators.cfgs
  env.sim.apply(built.spec)
  pose = {name: values[0] for name, values in built.initial_state.joint_pos.items() if len(values) == 1}
  if base == "free":
    return robot_on_ground(built.spec, cfgs, pose=pose, floor=0.0 if floor is None else floor, imu=imu)
  return robot_on_stand(built.spec, cfgs, pose=pose, height=wanted.height, floor=floor, imu=imu)


def task_ranges(env: Any) -> "dict[str, Range]":
  """Return operation and bounds of the scalar fields that a task's events randomise."""
  from mjlab_dr import FIELDS, FieldRandomizer

  found: dict[str, Range] = {}
  for event in env.events.values():
    for value in getattr(event, "params", {}).values():
      if isinstance(value, FieldRandomizer) and len(FIELDS[value.field].axes) == 1 and not FIELDS[value.field].integer:
        lo, hi = next(iter(value.values.values())).support()
        found[value.field] = (value.operation, lo, hi)
  return found
