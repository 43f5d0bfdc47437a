"""Help of the flags of a task, kept in a file so that it appears without importing the task.

The file is used as long as no module changed that was imported to build the task. It holds text only.
"""

import hashlib
import json
import os
import sys
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from mjlab_core import AtomicWrite, MjlabError, UsageError, nearest, printable

from mjlab.cli._help import FlagRow, flags_help
from mjlab.registry import task_entries

_LONGEST = 2000  # characters of a text from the file


def task_help(
  command: str, task: str, given: Sequence[str], word: str, rows: Callable[[], list[FlagRow]], *, notes: str = ""
) -> str:
  """Return the help on flags that have `word` in their names.

  Args:
    command: Name of the command.
    task: Name of the task.
    given: Words before `--help`; one of them may select a learner.
    word: Part of names; empty for all.
    rows: Function that builds the task and returns all flags; not called if the kept ones are up to date.
    notes: Text below all flags.

  Raises:
    UsageError: No flag has `word` in its name.
  """
  path = _path(command, task, given)
  known = None if path is None else _read(path)
  if known is None:
    known = rows()
    if path is not None:
      _write(path, known)
  word = word.strip("-").replace("_", "-").replace(" ", "-").lower()
  shown = [row for row in known if word in row.name.lower()]
  if not shown:
    close = nearest(word, dict.fromkeys(part for row in known for part in row.name.split(".")))
    raise UsageError(f"no flag has '{word}' in its name." + (f" Nearest: {', '.join(close)}." if close else ""))
  about = "" if word else f"{command} {task} --help WORD shows the flags that have WORD in their names."
  return flags_help(f"{command} {task} [flags]", about, shown, notes="" if word else notes)


def _path(command: str, task: str, given: Sequence[str]) -> Path | None:
  """Return the file of a task of an installed package; None for one that a script registered."""
  found = [entry.package for entry in task_entries() if entry.name == task]
  if len(found) != 1 or found[0] == "(registered)":
    return None
  root = os.environ.get("XDG_CACHE_HOME")
  folder = Path(root) if root else Path.home() / ".cache"
  # Several environments may have tasks of one name.
  parts = (command, task, *given, sys.prefix, sys.version, metadata.version("mjlab"), metadata.version(found[0]))
  return folder / "mjlab" / "help" / f"{hashlib.sha256(repr(parts).encode()).hexdigest()[:32]}.json"


def _read(path: Path) -> list[FlagRow] | None:
  try:
    kept = json.loads(path.read_text(encoding="utf-8"))
    if any(_stamp(file) != stamp for file, stamp in kept["files"].items()):
      return None
    return [FlagRow(*(printable(text, _LONGEST) for text in row)) for row in kept["flags"]]
  except (OSError, ValueError, LookupError, TypeError, AttributeError):
    return None


def _write(path: Path, rows: list[FlagRow]) -> None:
  files = {file: _stamp(file) for file in _sources()}
  try:
    path.parent.mkdir(parents=True, exist_ok=True)
    with AtomicWrite(path) as temporary:
      temporary.write_text(json.dumps({"files": files, "flags": rows}), encoding="utf-8")
  except (OSError, MjlabError):
    # Only the next help takes longer.
    return


def _sources() -> list[str]:
  """Return the files of all loaded modules of mjlab and of tasks; other packages do not change the flags of a task."""
  task_packages = {"mjlab", *(entry.package.replace("-", "_").lower() for entry in task_entries())}
  files: list[str] = []
  for name, module in list(sys.modules.items()):
    file: Any = getattr(module, "__file__", None)
    package = name.partition(".")[0]
    is_own = package.startswith("mjlab") or package.lower() in task_packages
    # torch has modules whose files have made-up names.
    if (
      isinstance(file, str) and os.path.isfile(file) and (is_own or not file.startswith((sys.prefix, sys.base_prefix)))
    ):
      files.append(file)
  return files


def _stamp(file: str) -> list[int]:
  found = os.stat(file)
  return [found.st_mtime_ns, found.st_size]
