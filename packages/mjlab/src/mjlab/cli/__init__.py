"""Command line: `mjlab COMMAND`, and each command under its own name.

Exit codes: 0 done (also after Ctrl-C, SIGTERM or SIGHUP, if the work was saved), 1 failed, 2 wrong command line: a word
or flag that does not exist, a value that is not allowed, or a task, run, file or device that does not exist.
"""

import contextlib
import gc
import importlib
import io
import os
import re
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Sequence
from importlib.metadata import version

from mjlab_core import ConfigError, FileError, MjlabError, UnknownNameError, UsageError, printable
from mjlab_core.names import check_name

_COMMANDS: dict[str, tuple[str, str]] = {
  # name: (words, summary)
  "train": ("TASK [flags]", "train a policy"),
  "play": ("TASK [flags]", "watch a policy"),
  "demo": ("[flags]", "watch a trained robot and steer it"),
  "evaluate": ("TASK [flags]", "measure a policy"),
  "convert-motion": ("CLIP ... [flags]", "check motion clips and convert them"),
  "record-motion": ("TASK [flags]", "record a policy as a motion clip"),
  "list-envs": ("[KEYWORD]", "list the tasks"),
  "inspect-dr": ("TASK [flags]", "show what the events of a task randomise"),
  "visualize-terrain": ("[TYPE ...] [flags]", "show terrain"),
  "export": ("RUN|CHECKPOINT [flags]", "write a policy as a bundle for robots"),
  "export-scene": ("TASK [flags]", "write the model of a task with its assets"),
  "viz-nan": ("FILE [flags]", "report why environments diverged"),
  "sysid": ("RECORDS ... [flags]", "fit parameters of a robot to its records"),
  "design-excitation": ("TASK --fit ... [flags]", "design motions that records should hold"),
  "sweep": ("TASK [flags]", "train a task with many values of its configuration"),
  "new": ("robot FILE|task NAME [flags]", "write a package for a robot or a task"),
  "train-actuator": ("RECORDS ... [flags]", "fit an actuator network to records of a motor"),
}

_CONFIGS = ("--env.", "--agent.", "--eval.")
_LONGEST = 5000  # characters of a message
_NO_MEMORY = re.compile(r"out of memory|can't allocate memory|failed to allocate", re.IGNORECASE)


def main(argv: Sequence[str] | None = None) -> int:
  """Run `mjlab COMMAND ...`; return the exit code."""
  words = list(sys.argv[1:] if argv is None else argv)
  if words[0:1] == ["help"] and len(words) > 1:
    words = [words[1], "--help", *words[2:]]
  if not words or words[0] in ("-h", "--help", "help"):
    print(_overview(), end="")
    return 0 if words else 2
  if words[0] == "--version":
    print(f"mjlab {version('mjlab')}")
    return 0
  return _run(words[0], words[1:])


def _overview() -> str:
  lines = [(f"{name} {words}", summary) for name, (words, summary) in _COMMANDS.items()]
  width = max(len(left) for left, _ in lines)
  listing = "\n".join(f"  {left:<{width}}   {summary}" for left, summary in lines)
  return (
    f"usage: mjlab COMMAND ...\n\n{listing}\n\n"
    "mjlab COMMAND --help explains a command; mjlab --version prints the version.\n"
  )


def __getattr__(name: str) -> Callable[..., int]:
  """Return the entry point of a command, which reads the arguments of the process unless it is given some."""
  if (command := name.replace("_", "-")) not in _COMMANDS:
    raise AttributeError(name)

  def run(argv: Sequence[str] | None = None) -> int:
    return _run(command, list(sys.argv[1:] if argv is None else argv))

  return run


def _run(name: str, words: list[str]) -> int:
  """Run a command. A user's mistake becomes a message; other errors also print a traceback."""
  # Most of what a start makes stays, and Python would search it for garbage 700 times.
  gc.set_threshold(50_000)
  if isinstance(sys.stdout, io.TextIOWrapper):
    # A name with letters that the terminal cannot show must not end the command.
    sys.stdout.reconfigure(errors="backslashreplace")
  try:
    with _interruptible():
      module = check_name("command", name, _COMMANDS).replace("-", "_")
      return importlib.import_module(f"mjlab.cli._{module}").run(words)
  except KeyboardInterrupt:
    print("interrupted", file=sys.stderr)
    return 130
  except BrokenPipeError:
    # The reader of the output has ended (`| head`); Python would complain again while it closes the output.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0
  except Exception as error:
    is_out_of_memory = _is_out_of_memory(error)
    is_expected = is_out_of_memory or isinstance(error, MjlabError | OSError)
    if not is_expected or ("--traceback" in words and not isinstance(error, UsageError)):
      traceback.print_exc()
    # Names from files are part of messages; only a list of problems has several lines.
    lines = str(error).splitlines() if isinstance(error, ConfigError) else [str(error)]
    message = "\n".join(printable(line, _LONGEST) for line in lines)
    if is_out_of_memory:
      message = f"not enough memory; use fewer environments: {(message.splitlines() or [''])[0]}"
    print(f"error: {message}", file=sys.stderr)
    return 2 if _is_wrong_line(error, words) else 1


def _is_wrong_line(error: Exception, words: Sequence[str]) -> bool:
  """Return True if another command line would have avoided an error, whatever the files hold."""
  if isinstance(error, UsageError | UnknownNameError):
    return True
  if isinstance(error, FileError):
    return isinstance(error.__cause__, FileNotFoundError)
  # A configuration that flags changed; one that is wrong without them is the task's mistake.
  return isinstance(error, ConfigError) and any(word.startswith(_CONFIGS) for word in words)


def _is_out_of_memory(error: BaseException) -> bool:
  """Return True if the machine or a GPU had too little memory; torch and Warp have no common class for this."""
  return isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and bool(_NO_MEMORY.search(str(error))))


@contextlib.contextmanager
def _interruptible() -> Generator[None]:
  """Let Ctrl-C end the command even if a shell script started it in the background, where Ctrl-C is ignored.

  A viewer runs until it is interrupted; otherwise it would keep its port after the script has ended.
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
