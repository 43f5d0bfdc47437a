"""Help of the flags of a task, kept in a file so that it appears without importing the task.

The file is used as long as no module changed that was imported to build the task.
"""

import contextlib
import hashlib
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
from mjlab_core import AtomicWrite, MjlabError, UsageError, nearest

from mjlab.cli.shared._help import FlagRow, help_text
from mjlab.registry import task_entries


def task_help(
  command: str, task: str, given: Sequence[str], word: str, build: Callable[[], Any], *, notes: str = ""
) -> str:
  """Return the help on flags that have `word` in their names.

  Args:
    command: Name of the command.
    task: Name of the task.
    given: Words before `--help`; one of them may select a learner.
    word: Part of names; empty for all.
    build: Function that builds the configuration; not called if the kept flags are up to date.
    notes: Text below all flags.

  Raises:
    UsageError: No flag has `word` in its name.
  """
  path = _path(command, task, given)
  known = None if path is None else _read(path)
  if known is None:
    from mjlab.cli.shared._flags import help_rows

    known = help_rows(build())
    if path is not None:
      _write(path, known)
  word = word.strip("-").replace("_", "-").replace(" ", "-").lower()
  shown = [row for row in known if word in row.name.lower()]
  if not shown:
    close = nearest(word, dict.fromkeys(part for row in known for part in row.name.split(".")))
    raise UsageError(f"no flag has '{word}' in its name." + (f" Nearest: {', '.join(close)}." if close else ""))
  about = "" if word else f"{command} {task} --help WORD shows the flags that have WORD in their names."
  return help_text(f"{command} {task} [flags]", about, shown, notes="" if word else notes)


class _Kept(msgspec.Struct):
  """Contents of a file: the flags of a task, and size and time of the modules that they were read from."""

  files: dict[str, tuple[int, int]]
  flags: list[FlagRow]


def _path(command: str, task: str, given: Sequence[str]) -> Path | None:
  """Return the file of a task of an installed package; None for one that a script registered."""
  if any(entry.name == task and entry.package == "(registered)" for entry in task_entries()):
    return None
  folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
  # Several environments may have tasks of one name.
  key = hashlib.sha256(repr((command, task, *given, sys.prefix)).encode()).hexdigest()
  return folder / "mjlab" / "help" / f"{key[:32]}.json"


def _read(path: Path) -> list[FlagRow] | None:
  try:
    kept = msgspec.json.decode(path.read_bytes(), type=_Kept)
    return kept.flags if all(_stamp(file) == stamp for file, stamp in kept.files.items()) else None
  except (OSError, msgspec.MsgspecError):
    return None


def _write(path: Path, rows: list[FlagRow]) -> None:
  found = {str(getattr(module, "__file__", None)) for module in list(sys.modules.values())}
  # torch has modules whose files have made-up names.
  files = {file: _stamp(file) for file in found if os.path.isfile(file)}
  # Without the file only the next help takes longer.
  with contextlib.suppress(OSError, MjlabError), AtomicWrite(path) as temporary:
    temporary.write_bytes(msgspec.json.encode(_Kept(files, rows)))


def _stamp(file: str) -> tuple[int, int]:
  found = os.stat(file)
  return found.st_mtime_ns, found.st_size
