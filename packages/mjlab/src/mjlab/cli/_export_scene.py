"""`export-scene TASK [flags]`: a task's model as MJCF with its assets."""

import dataclasses
import os
import shlex
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjlab.cli._errors import UsageError, building
from mjlab.cli._task_command import run_with_task

if TYPE_CHECKING:
  import mujoco
  from mjlab_rl import TaskCfg


@dataclasses.dataclass(kw_only=True)
class Arguments:
  """All that can be given after the task."""

  output: str | None = None
  """Folder to write; None: export/TASK."""
  play: bool = False
  """Take the configuration for watching instead of the one for training."""
  force: bool = False
  """Replace the folder where it exists."""
  traceback: bool = False
  """Show where an error came from."""
  env: Any = None
  """Configuration of the environment."""


def run(arguments: list[str]) -> int:
  """Export; returns the exit code."""
  purpose = "Writes a task's model with its assets; python -m mujoco.viewer opens it."
  return run_with_task("export-scene", arguments, _export, Arguments, purpose=purpose)


def _export(name: str, task: "TaskCfg[Any]", given: list[str]) -> int:
  from mjlab.cli._flag_parser import parse

  wanted = parse(Arguments(env=task.env), given)
  cfg = wanted.env if not wanted.play or task.play is None else task.play(wanted.env)
  folder = Path(wanted.output or f"export/{name}")
  if folder.exists() and not wanted.force:
    raise UsageError(f"{folder} exists; --force replaces it, --output names another folder")
  if folder.exists() and not (folder / "scene.xml").is_file():
    raise UsageError(f"{folder} is no exported scene (it has no scene.xml), so it is not replaced, not even by --force")
  from mjlab_scene import Scene

  with building():
    scene = Scene(cfg.scene, cfg.decimation)
    cfg.sim.apply(scene.spec)
    path = write_scene(scene.spec, folder)
  print(f"wrote {path}; open it with: python -m mujoco.viewer --mjcf {shlex.quote(str(path))}")
  return 0


def write_scene(spec: "mujoco.MjSpec", folder: Path) -> Path:
  """Write a spec and its files into `folder`, which appears whole and in place of what was there; returns the MJCF."""
  import mujoco

  assets = dict(spec.assets)
  folder.parent.mkdir(parents=True, exist_ok=True)
  made = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
  try:
    for number, part in enumerate((*spec.meshes, *spec.hfields, *spec.textures)):
      source = Path(part.file)
      if part.file and part.file not in assets:
        # Files of one name may come from several folders.
        part.file = f"{number}_{source.name}"
        assets[part.file] = source.read_bytes()
    spec.assets = assets
    spec.compile()
    (made / "scene.xml").write_text(spec.to_xml(), encoding="utf-8")
    for name, content in assets.items():
      target = made / name
      target.parent.mkdir(parents=True, exist_ok=True)
      target.write_bytes(content if isinstance(content, bytes) else content.encode())
    # What cannot be opened is not handed out.
    mujoco.MjModel.from_xml_path(str(made / "scene.xml"))
    made.chmod(0o755)
    if folder.exists():
      old = made.with_name(made.name + ".old")
      os.replace(folder, old)
      os.replace(made, folder)
      shutil.rmtree(old)
    else:
      os.replace(made, folder)
  except BaseException:
    shutil.rmtree(made, ignore_errors=True)
    raise
  return folder / "scene.xml"
