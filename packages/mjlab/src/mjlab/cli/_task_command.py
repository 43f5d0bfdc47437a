"""What commands that begin with a task share: finding it, telling its flags, building its environment."""

import itertools
import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from mjlab_core import unknown

from mjlab import making
from mjlab.cli._config_flags import flags
from mjlab.cli._errors import UsageError, building
from mjlab.registry import list_tasks, load_task

if TYPE_CHECKING:
  from mjlab_rl import RunManifest, TaskCfg


def run_with_task(
  command: str,
  words: list[str],
  action: "Callable[[str, TaskCfg[Any], list[str]], int]",
  arguments: Callable[..., Any],
  *,
  purpose: str,
  configs: "Callable[[TaskCfg[Any]], dict[str, Any]]" = lambda task: {"env": task.env},
  usage: str = "",
  more: str = "",
) -> int:
  """Run `command TASK [flags]`, or print its help; returns the exit code.

  Args:
    command: Name of the command.
    words: What was given behind it.
    action: What it does with the task's name, the task, and the words behind the name.
    arguments: Class of all that can be given after the task.
    purpose: What it does, for the help.
    configs: Those fields of `arguments` that are parts of the task.
    usage: What must be given beside the task.
    more: Lines to be added to the help.

  Raises:
    UsageError: The task is missing, not in the first place, or does not exist.
  """
  usage = f"usage: {command} TASK {usage}[flags]"
  if not words:
    raise UsageError(f"no task given. {usage}; list-envs lists the tasks.")
  name, *given = words
  if name in ("-h", "--help"):
    print(_general_help(command, purpose, arguments(), more), end="")
    return 0
  if name.startswith("-"):
    raise UsageError(f"the task comes first. {usage}")
  making.share_cores()
  task = load_named_task(name)
  word = _help_word(given)
  if word is not None:
    _print_task_help(command, name, arguments(**configs(task)), word)
    return 0
  return action(name, task, given)


def build_env(parts: "TaskCfg[Any] | RunManifest", cfg: Any, device: str) -> Any:
  """The environment of a task or a run, from a configuration.

  Raises:
    BuildError: The configuration cannot be built.
  """
  with building():
    return (parts.make_env or making.standard_env)(cfg, device=device)


def load_named_task(name: str) -> "TaskCfg[Any]":
  """The task that a command line names.

  Raises:
    UsageError: No such task; nothing heavy was imported.
  """
  if name not in list_tasks():
    raise UsageError(unknown("task", name, list_tasks()))
  return load_task(name)


def _help_word(given: list[str]) -> str | None:
  """What flags are asked for with `--help WORD`, "" for all; None where no help is asked for."""
  wants_help = [index for index, word in enumerate(given) if word in ("-h", "--help")]
  if not wants_help:
    return None
  words = itertools.takewhile(lambda word: word not in ("-h", "--help"), given[wants_help[0] + 1 :])
  return "-".join(words)


def _general_help(command: str, purpose: str, arguments: Any, more: str = "") -> str:
  """Help of a command before a task is named."""
  tasks = [f"  {name}" for name in list_tasks()] or ["  (none is installed)"]
  options = [f"  --{flag.name:<16}{flag.about}" for flag in flags(arguments)]
  return (
    "\n".join(
      [
        f"usage: {command} TASK [flags]\n\n{purpose}\n\ntasks:",
        *tasks,
        "\nflags:",
        *(textwrap.fill(option, 100, subsequent_indent=" " * 20) for option in options),
        "  --env.PATH        Any value of the environment, e.g. --env.scene.num-envs 8192.",
        *more.splitlines(),
      ]
    )
    + "\n"
  )


def _print_task_help(command: str, name: str, arguments: Any, word: str) -> None:
  """Print the flags of a task whose name contains `word`."""
  from mjlab.cli._flag_parser import print_help

  more = "" if word else f"{command} {name} --help WORD shows the flags whose name contains WORD."
  print_help(arguments, prog=f"{command} {name}", description=more, word=word)
