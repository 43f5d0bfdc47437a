"""Tasks by name. They are entry points of the group `mjlab.tasks`: listing reads names and imports nothing.

A package offers a task with an entry point whose name is the task id and whose target is a function without arguments
that returns a fresh `mjlab_rl.TaskCfg`.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjlab_core import unknown

if TYPE_CHECKING:
  from mjlab_rl import TaskCfg

GROUP = "mjlab.tasks"


class TaskError(ValueError):
  """A task that does not exist or cannot be loaded; the message says which and why."""


@dataclass(frozen=True, kw_only=True)
class TaskEntry:
  """One registered task, not loaded."""

  name: str
  """Task id."""
  package: str
  """Distribution that offers it, or "(registered)"."""
  load: Callable[[], Callable[[], Any]]
  """Imports and returns the function that builds the task."""


_registered: dict[str, TaskEntry] = {}


def task_entries() -> list[TaskEntry]:
  """All tasks, sorted by name; imports none of them."""
  entries = [
    TaskEntry(name=point.name, package=point.dist.name if point.dist else "?", load=point.load)
    for point in metadata.entry_points(group=GROUP)
  ]
  return sorted([*entries, *_registered.values()], key=lambda entry: entry.name)


def list_tasks() -> list[str]:
  """Ids of all tasks, sorted."""
  return sorted({entry.name for entry in task_entries()})


def register_task(name: str, build: Callable[[], "TaskCfg[Any]"]) -> None:
  """Offer a task from a script; packages use an entry point instead.

  Raises:
    TaskError: The id is taken.
  """
  if any(entry.name == name for entry in task_entries()):
    raise TaskError(f"task '{name}' is registered already")
  _registered[name] = TaskEntry(name=name, package="(registered)", load=lambda: build)


def load_task(name: str) -> "TaskCfg[Any]":
  """Build one task; the caller owns what it returns.

  Raises:
    TaskError: No such task (the message names the nearest), two packages offer it, or it cannot be imported.
  """
  package, build = _found(name)
  from mjlab_rl import TaskCfg

  task = build()
  if not isinstance(task, TaskCfg):
    raise TaskError(f"task '{name}' of {package}: expected a mjlab_rl.TaskCfg, got {type(task).__name__}")
  return task


def task_file(name: str) -> Path | None:
  """The file with the function that builds a task; None where there is none, as for one typed into a prompt.

  Raises:
    TaskError: As for `load_task`.
  """
  _, build = _found(name)
  try:
    file = Path(inspect.getfile(inspect.unwrap(build)))
  except TypeError:
    return None
  return file if file.is_file() else None


def _found(name: str) -> tuple[str, Callable[[], Any]]:
  """The package that offers a task, and the function that builds it."""
  found = [entry for entry in task_entries() if entry.name == name]
  if not found:
    raise TaskError(unknown("task", name, list_tasks()))
  if len(found) > 1:
    raise TaskError(f"task '{name}' is offered by several packages: {', '.join(entry.package for entry in found)}")
  try:
    return found[0].package, found[0].load()
  except (ImportError, AttributeError) as error:
    raise TaskError(f"task '{name}' of {found[0].package} cannot be imported: {error}") from error
