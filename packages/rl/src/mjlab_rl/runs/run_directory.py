"""Directories of runs, `<log root>/<experiment>/<date_time>[_<run name>]`, and the search for one."""

import contextlib
import re
from datetime import datetime
from pathlib import Path

from mjlab_core.errors import UnknownNameError
from mjlab_core.io.files import remove_leftovers, safe_name

from mjlab_rl.runs.manifest import manifest_entry

_RUN = re.compile(r"(\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d)(?:\.(\d+))?.*")
_CHECKPOINT = re.compile(r"model_(\d+)\.pt")


def create_run_directory(log_root: Path, experiment: str, run_name: str = "") -> Path:
  """Make a new directory named after the current time; two runs of one second get two.

  Names may come from an untrusted configuration, so each becomes one safe file name. Temporary files of killed runs of
  the experiment are removed.
  """
  stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
  suffix = f"_{safe_name(run_name)}" if run_name else ""
  folder = log_root / safe_name(experiment)
  # Separate, so that an error here does not count as an existing run.
  folder.mkdir(parents=True, exist_ok=True)
  remove_leftovers(folder)
  number = 1
  while True:
    path = folder / f"{stamp}{'' if number == 1 else f'.{number}'}{suffix}"
    with contextlib.suppress(FileExistsError):
      path.mkdir()
      return path
    number += 1


def checkpoints(directory: Path) -> list[Path]:
  """Return the checkpoints of a run, oldest first."""
  found = [
    (int(match[1]), path) for path in directory.glob("model_*.pt") if (match := _CHECKPOINT.fullmatch(path.name))
  ]
  return [path for _, path in sorted(found)]


def find_checkpoint(run: str, *, log_root: Path, experiment: str, task: str | None = None) -> Path:
  """Return the checkpoint that `run` names.

  Args:
    run: A checkpoint file, a run directory, the name of a run of the experiment, or "latest": the newest run of the
      experiment that has a checkpoint and is of `task`. A directory stands for its newest checkpoint.
    log_root: Folder of all experiments.
    experiment: Folder of this one, below it; empty: all experiments.
    task: Task of the latest run; None: any. A run without a manifest counts as of any task.

  Raises:
    UnknownNameError: Nothing fits.
  """
  folder, pattern = (log_root / safe_name(experiment), "*") if experiment else (log_root, "*/*")
  if run == "latest":
    trained = _trained_runs(folder, pattern)
    for directory, newest in trained.items():
      if task is None or manifest_entry(directory, "task") in (task, None):
        return newest
    of_task = "" if task is None else f" of {task}"
    instead = f"; {next(iter(trained)).name} is of another task, and must be given by name" if trained else ""
    raise UnknownNameError(f"no run{of_task} with a checkpoint in {folder}{instead}")
  for candidate in (Path(run), folder / run):
    if candidate.is_file():
      return candidate
    if candidate.is_dir():
      if found := checkpoints(candidate):
        return found[-1]
      inside = next(iter(_trained_runs(candidate)), None)
      newest = "" if inside is None else f"; the newest run in it that has one is {inside}"
      raise UnknownNameError(f"run {candidate} has no checkpoint{newest}")
  names = ", ".join(path.relative_to(folder).as_posix() for path in _runs(folder, pattern)[:5]) or "none"
  raise UnknownNameError(f"'{run}' is neither a checkpoint nor a run of {folder}; newest runs: {names}")


def find_launch(launch: str, *, log_root: Path, experiment: str) -> Path | None:
  """Return the newest checkpoint of the runs of one launch, which `torchrun` has restarted; None without one."""
  runs = _trained_runs(log_root / safe_name(experiment))
  return next((newest for run, newest in runs.items() if manifest_entry(run, "launch") == launch), None)


def _runs(folder: Path, pattern: str) -> list[Path]:
  """Return the folders that match a pattern, the newest run first."""
  return sorted((path for path in folder.glob(pattern) if path.is_dir()), key=_age, reverse=True)


def _trained_runs(folder: Path, pattern: str = "*") -> dict[Path, Path]:
  """Return the newest checkpoint of each matching run that has one, the newest run first."""
  return {run: found[-1] for run in _runs(folder, pattern) if (found := checkpoints(run))}


def _age(directory: Path) -> tuple[str, int]:
  """Return the sort key of a run directory: the time in its name; other names come first."""
  match = _RUN.fullmatch(directory.name)
  return (match[1], int(match[2] or 1)) if match else ("", 0)
