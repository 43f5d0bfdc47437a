"""Command lines of one form: `COMMAND WORDS [flags]`, where the words are a task, a file or nothing."""

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjlab_core import MjlabError, UsageError

from mjlab import environments
from mjlab.cli._help import FlagRow, command_help
from mjlab.cli._task_help import task_help
from mjlab.registry import list_tasks, load_task

if TYPE_CHECKING:
  from mjlab_rl import RunManifest, TaskCfg

_HELP = ("-h", "--help")


@dataclasses.dataclass(kw_only=True)
class CommonArguments:
  """Flags that every command has; a subclass adds its own."""

  traceback: bool = False
  """Show the traceback of an error."""


@dataclasses.dataclass(kw_only=True)
class TaskArguments(CommonArguments):
  """Flags of commands with a task."""

  env: Any = None
  """Configuration of the environment."""


@dataclasses.dataclass(kw_only=True)
class PageArguments(CommonArguments):
  """Flags of commands that show a page."""

  host: str = "127.0.0.1"
  """Address that the page listens on; 0.0.0.0 lets other machines connect."""
  port: int = 8080
  """Port of the page; the next free one if it is taken."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class CommandLine:
  """Form of a command: its words, its flags and its help."""

  name: str
  words: str
  """Words before the flags, as the help shows them: "TASK", "FILE", "[KEYWORD]" or ""."""
  purpose: str
  """Description, for the help."""
  arguments: Any
  """Dataclass of the flags; a field of type Any is a part of a task."""
  notes: str = ""
  """Text below the flags, for the help."""

  @property
  def usage(self) -> str:
    return " ".join(
      part for part in (self.name, self.words, "[flags]" * bool(dataclasses.fields(self.arguments))) if part
    )

  def wants_help(self, words: Sequence[str]) -> bool:
    """Print the help if it is asked for; return True then."""
    if not any(word in _HELP for word in words):
      return False
    print(command_help(self.usage, self.purpose, self.arguments, notes=self.notes), end="")
    return True

  def split(self, words: Sequence[str], most: int | None = 1) -> tuple[list[str], list[str]]:
    """Return the words before the flags, at most `most`, and the rest.

    Raises:
      UsageError: There are no such words, although the command needs some.
    """
    leading = list(itertools.takewhile(lambda word: not word.startswith("-"), words))[:most]
    if not leading and self.words and not self.words.startswith("["):
      raise UsageError(f"no {self.words.split()[0]} given. usage: {self.usage}")
    return leading, list(words[len(leading) :])


def run_with_words(
  line: CommandLine, words: list[str], action: Callable[[list[str], Any], int], most: int | None = 1
) -> int:
  """Run a command of the form `COMMAND WORDS [flags]`, or print its help; return the exit code.

  Args:
    line: Form of the command.
    words: Words after the name of the command.
    action: Function of the words before the flags, and of the arguments.
    most: Largest number of words before the flags; None: any.

  Raises:
    UsageError: The words are missing, or a flag is wrong.
  """
  if line.wants_help(words):
    return 0
  leading, flags = line.split(words, most)
  # tyro is heavy.
  from mjlab.cli._flags import parse

  return action(leading, parse(line.arguments(), flags))


def run_with_task(
  line: CommandLine,
  words: list[str],
  action: "Callable[[str, TaskCfg[Any], list[str]], int]",
  configs: "Callable[[TaskCfg[Any]], dict[str, Any]]" = lambda task: {"env": task.env},
  variant: str = "",
) -> int:
  """Run a command of the form `COMMAND TASK [flags]`, or print its help; return the exit code.

  Args:
    line: Form of the command.
    words: Words after the name of the command.
    action: Function of the task's id, the task, and the flags.
    configs: Parts of the task among the fields of `line.arguments`.
    variant: Name of the learner that `configs` takes in place of that of the task.

  Raises:
    UsageError: The task is missing, does not come first, or does not exist.
  """
  if words and words[0] in _HELP:
    tasks = "".join(f"\n  {name}" for name in list_tasks()) or "\n  (none is installed)"
    notes = f"  --env.PATH VALUE          Any value of the environment, e.g. --env.scene.num-envs 8192.\n{line.notes}"
    dataclasses.replace(line, notes=f"{notes}\ntasks:{tasks}").wants_help(words)
    return 0
  (name,), given = line.split(words)
  if any(word in _HELP for word in given):
    text = {"variant": variant, "notes": line.notes}
    print(task_help(line.name, name, _help_word(given), lambda: _rows(line, name, configs), **text), end="")
    return 0
  return action(name, load_task(name), given)


def _rows(line: CommandLine, name: str, configs: "Callable[[TaskCfg[Any]], dict[str, Any]]") -> list[FlagRow]:
  task = load_task(name)
  from mjlab.cli._flags import help_rows

  return help_rows(line.arguments(**configs(task)))


def _help_word(words: list[str]) -> str:
  """Return the words after `--help`, joined; empty if there are none."""
  after = itertools.dropwhile(lambda word: word not in _HELP, words)
  return "-".join(itertools.takewhile(lambda word: word not in _HELP, itertools.islice(after, 1, None)))


def output_file(flag: str, path: str | Path, ending: str = "", *, force: bool) -> Path:
  """Return the file that a flag names for writing, with this ending if one is given; its folder need not exist.

  Raises:
    UsageError: It has another ending, is a folder, or exists and may not be overwritten.
  """
  path = Path(path)
  if path.is_dir():
    raise UsageError(f"{flag}: {path} is a folder; name a file in it")
  if ending and path.suffix.lower() != ending:
    raise UsageError(f"{flag}: {path} does not end in {ending}")
  if path.exists() and not force:
    raise UsageError(f"{flag}: {path} exists; --force overwrites it")
  return path


def output_folder(folder: Path, mark: str, *, force: bool) -> Path:
  """Return a folder for writing.

  Raises:
    UsageError: It exists and may not be replaced, or is another folder: it has no file `mark`.
  """
  if folder.exists() and not force:
    raise UsageError(f"{folder} exists; --force replaces it, --output names another folder")
  if folder.exists() and not (folder / mark).is_file():
    raise UsageError(f"{folder} has no {mark}, so it is not replaced")
  return folder


def beside(source: Path, name: str) -> Path:
  """Return the path `name` in the folder of a file; in the working folder if the file is part of a Python package."""
  is_installed = any((folder / "__init__.py").is_file() for folder in source.resolve().parents)
  return Path(name) if is_installed else source.parent / name


def build_env(parts: "TaskCfg[Any] | RunManifest", cfg: Any, device: str) -> Any:
  """Build the environment of a task or a run from a configuration.

  Raises:
    MjlabError: The configuration cannot be built.
  """
  from mjlab_rl import RunManifest

  with building(from_file=isinstance(parts, RunManifest)):
    return (parts.make_env or environments.standard_env)(cfg, device=device)


@contextlib.contextmanager
def as_usage(flag: str = "") -> Generator[None]:
  """Turn the refusal of a value into UsageError; the message begins with the flag that gives the value."""
  try:
    yield
  except ValueError as error:
    raise UsageError(f"{flag}: {error}" if flag else str(error)) from error


@contextlib.contextmanager
def building(*, from_file: bool = False) -> Generator[None]:
  """Turn errors that other libraries raise about a configuration, such as MuJoCo, into MjlabError.

  Args:
    from_file: The configuration is read from a run, so that any failure may be the file's.
  """
  try:
    yield
  except Exception as error:
    if isinstance(error, (MjlabError, MemoryError)) or not (from_file or isinstance(error, (ValueError, OSError))):
      raise
    kind = "" if isinstance(error, (ValueError, OSError)) else f"the configuration fails with {type(error).__name__}: "
    raise MjlabError(f"{kind}{error}") from error
