"""`new robot FILE` and `new task NAME`: packages to begin with."""

import shlex
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from mjlab_core import UsageError, printable, unknown

from mjlab.cli.shared._command_line import CommandLine, CommonArguments, building
from mjlab.new.package import check_new_package, package_name, write_package
from mjlab.new.task import task_files, task_id
from mjlab.registry import list_tasks


@dataclass(kw_only=True)
class RobotArguments(CommonArguments):
  """All that can be given after the model file."""

  name: str = ""
  """Name of the package; empty: that of the file."""
  output: str | None = None
  """Folder to write, which must not exist; None: the name of the package."""
  base: Literal["file", "floating", "fixed"] = "file"
  """Base of the robot; "file" takes that of an MJCF, and guesses that of a URDF."""
  motors: tuple[str, ...] = ()
  """PATTERN=EFFORT[,ARMATURE[,SPEED]] of joints [N m, kg m^2, rad/s], in place of those of the file."""
  home: tuple[str, ...] = ()
  """PATTERN=POSITION of joints [rad, m]; others take the file's first keyframe."""
  torso: str = ""
  """Body of the torso; empty: the heaviest."""
  feet: tuple[str, ...] = ()
  """Patterns of the bodies of feet; none: the last links that reach the ground."""


_ROBOT = CommandLine("new robot", "FILE", RobotArguments)


@dataclass(kw_only=True)
class TaskArguments(CommonArguments):
  """Arguments after the name."""

  like: Literal["velocity", "tracking", "lift", "empty"] = "empty"
  """Family that the task begins with."""
  robot: str = ""
  """Installed package of a legged robot that `new robot` wrote, for velocity; empty: a robot of mjlab."""
  output: str | None = None
  """Folder to write, which must not exist; None: the name."""


_TASK = CommandLine("new task", "NAME", TaskArguments)


@_ROBOT
def _new_robot(wanted: RobotArguments, files: list[str]) -> int:
  """Read a robot from an .xml (MJCF) or .urdf file, and write a Python package.

  It has the robot's entity with servos from the file or from motor data, collision set, feet and torso, a home pose
  that settled under gravity, a picture, and a test that it stands.
  """
  file = Path(files[0])
  name = wanted.name or package_name(file.stem)
  folder = Path(wanted.output or name)
  check_new_package(name, folder)
  from mjlab.new.robot import read_robot, robot_files, write_model

  with building(from_file=True):
    new = read_robot(file, **{name: getattr(wanted, name) for name in ("base", "motors", "home", "torso", "feet")})
    made = robot_files(new, name)
    write_package(folder, made, lambda root: write_model(new.robot.spec, root / "src" / name / "model"))
  for line in new.report():
    print(line)
  if "robot.png" in made:
    print(f"look at {folder / 'robot.png'}")
  print(f"wrote {folder}; next: uv pip install -e {shlex.quote(str(folder))} && pytest {shlex.quote(str(folder))}")
  return 0


@_TASK
def _new_task(wanted: TaskArguments, names: list[str]) -> int:
  """Write a Python package with a task.

  It has an environment, an example of a term, a learner, the entry point that offers it to train and the other
  commands, a README, and a test that trains for two iterations. The package my_walk offers the task My-Walk.
  """
  (name,) = names
  folder = Path(wanted.output or name)
  check_new_package(name, folder)
  if task_id(name) in list_tasks():
    raise UsageError(f"a task '{task_id(name)}' exists already; choose another name")
  if wanted.robot and wanted.like != "velocity":
    raise UsageError("--robot: only tasks like velocity take a robot")
  if wanted.robot and (not wanted.robot.isidentifier() or find_spec(wanted.robot) is None):
    raise UsageError(f"--robot: no package {printable(wanted.robot)!r} is installed")
  write_package(folder, task_files(name, wanted.like, wanted.robot))
  print(f"wrote {folder}, which offers {task_id(name)}; next: uv pip install -e {shlex.quote(str(folder))}")
  return 0


def run(words: list[str]) -> int:
  """Write a package; return the exit code."""
  kinds = {"robot": _new_robot, "task": _new_task}
  kind = words[0] if words else ""
  if kind in ("-h", "--help"):
    return max(new([kind]) for new in kinds.values())
  if kind not in kinds:
    problem = unknown("kind", kind, kinds) if kind else "nothing given."
    raise UsageError(f"{problem} usage: {_ROBOT.usage}; {_TASK.usage}")
  return kinds[kind](words[1:])
