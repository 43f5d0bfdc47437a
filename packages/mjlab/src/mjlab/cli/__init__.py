"""The command line: `mjlab train`, `mjlab list-envs`, and the same two as commands of their own.

Exit codes: 0 done (also after a stop with Ctrl-C that saved), 1 failed, 2 wrong usage.
"""

import os
import sys
from collections.abc import Callable, Sequence

from mjlab.cli._errors import UsageError, is_users_mistake

_HELP = """\
usage: mjlab COMMAND ...

  train TASK [flags]    train a policy
  list-envs [KEYWORD]   list the tasks

mjlab COMMAND --help says more; mjlab --version names the version.
"""


def main(argv: Sequence[str] | None = None) -> int:
  """`mjlab COMMAND ...`"""
  arguments = list(sys.argv[1:] if argv is None else argv)
  if not arguments or arguments[0] in ("-h", "--help", "help"):
    print(_HELP, end="")
    return 0 if arguments else 2
  if arguments[0] == "--version":
    from importlib.metadata import version

    print(f"mjlab {version('mjlab')}")
    return 0
  commands = {"train": train, "list-envs": list_envs}
  command = commands.get(arguments[0])
  if command is None:
    from mjlab_core import unknown

    print(f"error: {unknown('command', arguments[0], list(commands))}", file=sys.stderr)
    return 2
  return command(arguments[1:])


def train(argv: Sequence[str] | None = None) -> int:
  """`train TASK [flags]`"""
  from mjlab.cli import _train

  return _guarded(_train.run, argv)


def list_envs(argv: Sequence[str] | None = None) -> int:
  """`list-envs [KEYWORD]`"""
  from mjlab.cli import _list_envs

  return _guarded(_list_envs.run, argv)


def _guarded(command: Callable[[list[str]], int], argv: Sequence[str] | None) -> int:
  """Run a command; what the user got wrong becomes one line, what we got wrong a traceback."""
  arguments = list(sys.argv[1:] if argv is None else argv)
  try:
    return command(arguments)
  except UsageError as error:
    print(f"error: {error}", file=sys.stderr)
    return 2
  except KeyboardInterrupt:
    print("interrupted", file=sys.stderr)
    return 130
  except BrokenPipeError:
    # The reader of our output left (`| head`); Python would complain once more while closing it.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0
  except Exception as error:
    if "--traceback" in arguments or not is_users_mistake(error):
      import traceback

      traceback.print_exc()
    print(f"error: {error}", file=sys.stderr)
    return 1
