"""`export-scene TASK [flags]`: a task's model as MJCF with its assets."""

import dataclasses
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjlab_core import safe_name

from mjlab.cli._command_line import CommandLine, TaskArguments, building, output_folder, run_with_task

if TYPE_CHECKING:
  from mjlab_rl import TaskCfg


@dataclasses.dataclass(kw_only=True)
class Arguments(TaskArguments):
  """All that can be given after the task."""

  output: str | None = None
  """Folder to write; None: export/TASK."""
  play: bool = False
  """Use the configuration for watching instead of the one for training."""
  force: bool = False
  """Replace an existing folder."""


_LINE = CommandLine(
  name="export-scene",
  words="TASK",
  purpose="Writes a task's model with its assets; python -m mujoco.viewer opens it.",
  arguments=Arguments,
)


def run(words: list[str]) -> int:
  """Export; return the exit code."""
  return run_with_task(_LINE, words, _export)


def _export(name: str, task: "TaskCfg[Any]", given: list[str]) -> int:
  from mjlab.cli._flags import parse

  wanted = parse(Arguments(env=task.env), given)
  cfg = wanted.env if not wanted.play or task.play is None else task.play(wanted.env)
  folder = output_folder(Path(wanted.output or f"export/{safe_name(name)}"), "scene.xml", force=wanted.force)
  from mjlab_scene import Scene

  with building():
    scene = Scene(cfg.scene, cfg.decimation)
    cfg.sim.apply(scene.spec)
    path = scene.write(folder)
  print(f"wrote {path}; open it with: python -m mujoco.viewer --mjcf {shlex.quote(str(path))}")
  return 0
