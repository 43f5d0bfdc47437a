"""Registry of tasks. Tasks are entry points of the group `mjlab.tasks`; listing them reads names and imports nothing.

A package offers a task by an entry point. Its name is the task id; its target is a function without arguments that
returns a new `mjlab_rl.TaskCfg`.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from mjlab_core import ConfigError, UnknownNameError, require, unknown
from mjlab_rl import TaskCfg
from mjlab_rl.runs.references import TASK_GROUP, distribution_name, trust_package


@dataclass(frozen=True, kw_only=True)
class TaskEntry:
  """One registered task, not loaded."""

  name: str
  """Task id."""
  package: str
  """Distribution that offers the task, or "(registered)"."""
  load: Callable[[], Callable[[], Any]]
  """Function that imports and returns the function that builds the task."""


_registered: dict[str, TaskEntry] = {}


def task_entries() -> list[TaskEntry]:
  """Return all tasks, sorted by name, without importing them."""
  entries = [
    TaskEntry(name=point.name, package=distribution_name(point.dist) if point.dist else "?", load=point.load)
    for point in metadata.entry_points(group=TASK_GROUP)
  ]
  return sorted([*entries, *_registered.values()], key=lambda entry: entry.name)


def list_tasks() -> list[str]:
  """Return the ids of all tasks, sorted."""
  return sorted({entry.name for entry in task_entries()})


def register_task(name: str, build: Callable[[], "TaskCfg[Any]"]) -> None:
  """Register a task from a script; packages use an entry point instead.

  The package of `build` is trusted from now on: manifests of runs may name its functions.

  Raises:
    ConfigError: The id is taken.
  """
  if any(entry.name == name for entry in task_entries()):
    raise ConfigError(f"task '{name}' is registered already")
  if (package := getattr(build, "__module__", "__main__").partition(".")[0]) != "__main__":
    trust_package(package)
  _registered[name] = TaskEntry(name=name, package="(registered)", load=lambda: build)


def load_task(name: str) -> "TaskCfg[Any]":
  """Build one task; the caller owns the result.

  Raises:
    UnknownNameError: The task does not exist; the message names the nearest.
    ConfigError: Two packages offer the task, it cannot be imported, or its function returns another type.
  """
  package, build = _found(name)
  task = build() if callable(build) else build
  wanted = "its entry point must name a function that returns a mjlab_rl.TaskCfg"
  return require(task, TaskCfg, f"task '{name}' of {package}: {wanted}; got {type(task).__name__}")


def task_file(name: str) -> Path | None:
  """Return the file of the function that builds a task; None if it has no file, as at a prompt.

  Raises:
    UnknownNameError, ConfigError: As for `load_task`.
  """
  _, build = _found(name)
  try:
    file = Path(inspect.getfile(inspect.unwrap(build)))
  except TypeError:
    return None
  return file if file.is_file() else None


def _found(name: str) -> tuple[str, Callable[[], Any]]:
  """Return the package that offers a task, and the function that builds the task."""
  found = [entry for entry in task_entries() if entry.name == name]
  if not found:
    raise UnknownNameError(unknown("task", name, list_tasks()))
  if len(found) > 1:
    raise ConfigError(f"task '{name}' is offered by several packages: {', '.join(entry.package for entry in found)}")
  try:
    return found[0].package, found[0].load()
  except (ImportError, AttributeError) as error:
    raise ConfigError(f"task '{name}' of {found[0].package} cannot be imported: {error}") from error
