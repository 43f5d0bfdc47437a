"""`export-scene TASK [flags]`: a task's model as MJCF with its assets."""

import shlex
from dataclasses import dataclass
from pathlib import Path

from mjlab_core import safe_name

from mjlab.cli.shared._command_line import CommandLine, TaskArguments, TaskLine, building, output_folder


@dataclass(kw_only=True)
class Arguments(TaskArguments):
  """All that can be given after the task."""

  output: str | None = None
  """Folder to write; None: export/TASK."""
  play: bool = False
  """Use the configuration for watching instead of the one for training."""
  force: bool = False
  """Replace an existing folder."""


@CommandLine("export-scene", "TASK", Arguments)
def run(wanted: Arguments, line: TaskLine) -> int:
  """Write a task's model with its assets; python -m mujoco.viewer opens it."""
  play = line.task.play
  cfg = play(wanted.env) if wanted.play and play is not None else wanted.env
  folder = output_folder(Path(wanted.output or f"export/{safe_name(line.name)}"), "scene.xml", force=wanted.force)
  from mjlab_scene import Scene

  with building():
    scene = Scene(cfg.scene, cfg.decimation)
    cfg.sim.apply(scene.spec)
    path = scene.write(folder)
  print(f"wrote {path}; open it with: python -m mujoco.viewer --mjcf {shlex.quote(str(path))}")
  return 0
