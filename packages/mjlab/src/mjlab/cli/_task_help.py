"""What commands that begin with a task share: finding it, and telling its flags."""

import itertools
import textwrap
from typing import TYPE_CHECKING, Any

from mjlab_core import unknown

from mjlab.cli._config_flags import flags
from mjlab.cli._errors import UsageError
from mjlab.registry import list_tasks, load_task

if TYPE_CHECKING:
  from mjlab_rl import TaskCfg


def load_named_task(name: str) -> "TaskCfg[Any]":
  """The task that a command line names.

  Raises:
    UsageError: No such task; nothing heavy was imported.
  """
  if name not in list_tasks():
    raise UsageError(unknown("task", name, list_tasks()))
  return load_task(name)


def help_word(given: list[str]) -> str | None:
  """What flags are asked for with `--help WORD`, "" for all; None where no help is asked for."""
  wants_help = [index for index, word in enumerate(given) if word in ("-h", "--help")]
  if not wants_help:
    return None
  words = itertools.takewhile(lambda word: word not in ("-h", "--help"), given[wants_help[0] + 1 :])
  return "-".join(words)


def general_help(command: str, purpose: str, arguments: Any, more: str = "") -> str:
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


def print_task_help(command: str, name: str, arguments: Any, word: str) -> None:
  """Print the flags of a task whose name contains `word`."""
  from mjlab.cli._flag_parser import print_help

  more = "" if word else f"{command} {name} --help WORD shows the flags whose name contains WORD."
  print_help(arguments, prog=f"{command} {name}", description=more, word=word)
