"""Command lines of one form: `COMMAND WORDS [flags]`, where the words are a task, a file or nothing."""

import argparse
import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

import mjlab_rl
from mjlab_core import MjlabError, UsageError
from mjlab_core.constraints import field_problems
from mjlab_rl import RunManifest, TaskCfg

from mjlab import environments
from mjlab.cli.shared._help import field_rows, help_text
from mjlab.cli.shared._task_help import task_help
from mjlab.registry import list_tasks, load_task

_HELP = {"-h", "--help"}


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


Loaded = tuple["TaskCfg[Any]", list[str], list[str]]
"""Task, all words after its id, and the flags among them that set values of the arguments."""


@dataclasses.dataclass(frozen=True)
class TaskLine:
  """Command line with a task."""

  name: str
  """Task id."""
  arguments: Any
  """Dataclass of the flags."""
  task: "TaskCfg[Any]"
  given: list[str]
  """All words after the task."""
  flags: list[str]
  """Flags among them that set values of the arguments."""

  def defaults(self, **parts: Any) -> Any:
    """Return the arguments without flags, with the parts of the task except for those given."""
    evaluator = self.task.evaluator or mjlab_rl.ReturnEvaluation()
    own = {"env": self.task.env, "agent": self.task.agent, "eval": evaluator, **parts}
    return self.arguments(
      **{field.name: own[field.name] for field in dataclasses.fields(self.arguments) if field.type is Any}
    )

  def parse(self, **parts: Any) -> Any:
    """Return the arguments with the flags set; `parts` are defaults other than those of the task."""
    return parse_flags(self.defaults(**parts), self.flags)


def _load(name: str, given: list[str]) -> Loaded:
  return load_task(name), given, given


def parse_flags(arguments: Any, flags: list[str]) -> Any:
  """Return the arguments with `flags` set.

  Raises:
    UsageError: A flag does not exist, or does not take its value.
  """
  if flags:
    # tyro is heavy.
    from mjlab.cli.shared._flags import parse

    arguments = parse(arguments, flags)
  for name, _, rule in (problem.partition(" ") for problem in field_problems(arguments)):
    raise UsageError(f"--{name.replace('_', '-')} {rule}")
  return arguments


@dataclasses.dataclass(frozen=True)
class CommandLine:
  """Form of a command: its words, its flags and its help. It decorates the function that does the work."""

  name: str
  words: str
  """Words before the flags, as the help shows them: "TASK", "FILE", "CLIP [MORE ...]", "[KEYWORD]" or ""."""
  arguments: Any
  """Dataclass of the flags; a field of type Any is a part of a task."""
  notes: str = ""
  """Text below the flags, for the help."""
  load: Callable[[str, list[str]], Loaded] = _load
  """Function of a task id and the words after it."""

  def __call__(self, action: Callable[[Any, Any], int]) -> Callable[[list[str]], int]:
    """Return the command as a function of its words, with the exit code as result.

    Args:
      action: Function of the arguments and of the `TaskLine`; without a task, of the words before the flags. Its
        docstring is the description in the help.
    """

    def run(words: list[str]) -> int:
      if self._has_task and words and words[0] not in _HELP:
        return self._run_task(action, words)
      if self.wants_help(words, action):
        return 0
      leading, flags = self.split(words)
      return action(parse_flags(self.arguments(), flags), leading)

    return run

  def _run_task(self, action: Callable[[Any, TaskLine], int], words: list[str]) -> int:
    (name,), words = self.split(words)
    given = list(itertools.takewhile(lambda word: word not in _HELP, words))
    if len(given) == len(words):
      line = TaskLine(name, self.arguments, *self.load(name, given))
      return action(line.parse(), line)

    def build() -> Any:
      return TaskLine(name, self.arguments, *self.load(name, given)).defaults()

    print(task_help(self.name, name, given, "-".join(words[len(given) + 1 :]), build, notes=self.notes), end="")
    return 0

  def wants_help(self, words: Sequence[str], action: Callable[..., int]) -> bool:
    """Print the help if it is asked for; return True then."""
    if _HELP.isdisjoint(words):
      return False
    notes = self.notes
    if self._has_task:
      tasks = "".join(f"\n  {name}" for name in list_tasks()) or "\n  (none is installed)"
      value = "  --env.PATH VALUE          Any value of the environment, e.g. --env.scene.num-envs 8192."
      notes = f"{value}\n{notes}\ntasks:{tasks}"
    print(help_text(self.usage, action.__doc__ or "", field_rows(self.arguments), notes=notes), end="")
    return True

  @property
  def _has_task(self) -> bool:
    return self.words.startswith("TASK")

  @property
  def usage(self) -> str:
    return " ".join(part for part in (self.name, self.words, "[flags]") if part)

  def split(self, words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the words before the flags, at most one unless the form has "...", and the rest.

    Raises:
      UsageError: There are no such words, although the command needs some.
    """
    most = None if "..." in self.words else 1
    leading = list(itertools.takewhile(lambda word: not word.startswith("-"), words))[:most]
    if not leading and self.words and not self.words.startswith("["):
      raise UsageError(f"no {self.words.split()[0]} given. usage: {self.usage}")
    return leading, list(words[len(leading) :])


def take(words: Sequence[str], flag: str, **options: Any) -> tuple[Any, list[str]]:
  """Return the value of a flag, None if it is not given, and the other words.

  Args:
    words: Words of a command line.
    flag: Name of the flag, with the two hyphens.
    options: Arguments of `argparse.ArgumentParser.add_argument`; without any, a missing value is an empty string.
  """
  parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
  parser.add_argument(flag, dest="value", **(options or {"nargs": "?", "const": ""}))
  found, others = parser.parse_known_args(words)
  return found.value, others


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


@contextlib.contextmanager
def built_env(parts: "TaskCfg[Any] | RunManifest", cfg: Any, device: str) -> Generator[Any]:
  """Build the environment of a task or a run from a configuration, and close it at the end.

  Raises:
    MjlabError: The configuration cannot be built.
  """
  with building(from_file=isinstance(parts, RunManifest)):
    env = (parts.make_env or environments.standard_env)(cfg, device=device)
  try:
    yield env
  finally:
    env.close()


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
