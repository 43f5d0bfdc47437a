"""The command line: `mjlab COMMAND`, and each of its commands as one of its own.

Exit codes: 0 done (also after a stop with Ctrl-C, SIGTERM or SIGHUP that saved), 1 failed, 2 wrong usage.
"""

import contextlib
import importlib
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Sequence

from mjlab.cli._errors import UsageError, is_out_of_memory, is_users_mistake

_COMMANDS: dict[str, tuple[str, str, str]] = {
  # name: module here, or function of a member that offers the command itself; arguments; what it does
  "train": ("_train", "TASK [flags]", "train a policy"),
  "play": ("_play", "TASK [flags]", "watch a policy"),
  "demo": ("_demo", "[flags]", "watch a robot that walks, and steer it"),
  "evaluate": ("_evaluate", "TASK [flags]", "say how well a policy does a task"),
  "convert-motion": ("mjlab_tracking.convert:main", "CLIP ... [flags]", "make a checked motion file of a clip"),
  "record-motion": ("_record_motion", "TASK [flags]", "turn what a policy does into a clip"),
  "list-envs": ("_list_envs", "[KEYWORD]", "list the tasks"),
  "inspect-dr": ("_inspect_dr", "TASK [flags]", "show what the events of a task do"),
  "visualize-terrain": ("mjlab_terrain.visualize:main", "[flags]", "look at terrain"),
  "export-scene": ("_export_scene", "TASK [flags]", "write a task's model with its assets"),
  "viz-nan": ("_viz_nan", "FILE [flags]", "show why worlds diverged"),
  "fit-actuator": ("_fit_actuator", "RECORDS [flags]", "learn a motor from a CSV of commands and responses"),
}


def main(argv: Sequence[str] | None = None) -> int:
  """`mjlab COMMAND ...`"""
  arguments = list(sys.argv[1:] if argv is None else argv)
  if arguments[0:1] == ["help"] and len(arguments) > 1:
    arguments = [arguments[1], "--help", *arguments[2:]]
  if not arguments or arguments[0] in ("-h", "--help", "help"):
    print(_help(), end="")
    return 0 if arguments else 2
  if arguments[0] == "--version":
    from importlib.metadata import version

    print(f"mjlab {version('mjlab')}")
    return 0
  if arguments[0] not in _COMMANDS:
    from mjlab_core import unknown

    print(f"error: {unknown('command', arguments[0], list(_COMMANDS))}", file=sys.stderr)
    return 2
  return _run(arguments[0], arguments[1:])


def _help() -> str:
  lines = [(f"{name} {arguments}", summary) for name, (_, arguments, summary) in _COMMANDS.items()]
  width = max(len(left) for left, _ in lines)
  listing = "\n".join(f"  {left:<{width}}   {summary}" for left, summary in lines)
  return (
    f"usage: mjlab COMMAND ...\n\n{listing}\n\nmjlab COMMAND --help says more; mjlab --version names the version.\n"
  )


def _command(name: str) -> Callable[..., int]:
  """The entry point of a command's own name, which takes the arguments of the process unless it is given some."""

  def run(argv: Sequence[str] | None = None) -> int:
    return _run(name, list(sys.argv[1:] if argv is None else argv))

  return run


def _run(name: str, arguments: list[str]) -> int:
  module, _, function = _COMMANDS[name][0].rpartition(":")
  command = getattr(importlib.import_module(module or f"mjlab.cli.{function}"), function if module else "run")
  return _guarded(command, arguments)


train = _command("train")
play = _command("play")
demo = _command("demo")
evaluate = _command("evaluate")
record_motion = _command("record-motion")
list_envs = _command("list-envs")
inspect_dr = _command("inspect-dr")
export_scene = _command("export-scene")
viz_nan = _command("viz-nan")
fit_actuator = _command("fit-actuator")


def _guarded(command: Callable[[list[str]], int], arguments: list[str]) -> int:
  """Run a command; what the user got wrong becomes one line, what we got wrong a traceback."""
  if isinstance(sys.stdout, io.TextIOWrapper):
    # A name that the terminal has no letters for is no reason to stop.
    sys.stdout.reconfigure(errors="backslashreplace")
  try:
    with _interruptible():
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
    print(f"error: {_told(error)}", file=sys.stderr)
    return 1


def _told(error: Exception) -> str:
  if not is_out_of_memory(error):
    return str(error)
  return f"not enough memory, fewer worlds need less: {(str(error).splitlines() or [''])[0]}"


@contextlib.contextmanager
def _interruptible() -> Generator[None]:
  """Ctrl-C ends what runs in here, also what a script has in the background, whose shell starts it with Ctrl-C ignored.

  A viewer goes on until it is interrupted; one that cannot be keeps its port when the script is long gone.
  """
  before = signal.getsignal(signal.SIGINT)
  if before != signal.SIG_IGN or threading.current_thread() is not threading.main_thread():
    yield
    return
  signal.signal(signal.SIGINT, signal.default_int_handler)
  try:
    yield
  finally:
    signal.signal(signal.SIGINT, before)
