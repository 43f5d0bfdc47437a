"""Atomic writes, and names from files made safe for the disk and the terminal."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import shutil
import socket
import time
import unicodedata
from collections.abc import Generator
from pathlib import Path
from types import TracebackType

from mjlab_core.errors import FileError, MjlabError

_COUNTER = itertools.count()
_WRITING: set[Path] = set()
_TEMPORARY = re.compile(r"\..*\.(?P<host>[\w-]*)\.(?P<pid>\d+)-\d+\.tmp(\.\w*)?")
_ABANDONED = 24 * 3600.0
_MAX_NAME_BYTES = 120


class AtomicWrite:
  """File or folder that appears under its name whole, or not at all.

  Used as a context manager, it returns a temporary path beside the target, with the target's suffix. The caller creates
  a file or a folder there. A normal exit calls `commit`, an exception calls `discard`. A power cut after `commit` loses
  nothing: data and names are synced to the disk.

  Args:
    path: Target. Replaced if it exists. Missing parent folders are created.
  """

  def __init__(self, path: str | os.PathLike[str]) -> None:
    self.path = Path(path)
    stem = self.path.stem.encode()[:_MAX_NAME_BYTES].decode(errors="ignore")
    name = f".{stem}.{_host()}.{os.getpid()}-{next(_COUNTER)}.tmp{self.path.suffix[:16]}"
    self.temporary = self.path.with_name(name)
    self.path.parent.mkdir(parents=True, exist_ok=True)
    _WRITING.add(self.temporary)

  def commit(self) -> None:
    """Sync the temporary file or folder and rename it to the target.

    Raises:
      OSError: The disk is full, or the target cannot be replaced. The target is unchanged then.
    """
    try:
      for item in [*self.temporary.rglob("*"), self.temporary]:
        _sync(item)
      if self.temporary.is_dir() and self.path.exists():
        self._replace_folder()
      else:
        os.replace(self.temporary, self.path)
      _sync(self.path.parent)
    finally:
      self.discard()

  def _replace_folder(self) -> None:
    """Swap folders, because one cannot be renamed over another that holds files."""
    old = self.temporary.with_suffix(".old")
    os.replace(self.path, old)
    try:
      os.replace(self.temporary, self.path)
    except OSError:
      os.replace(old, self.path)
      raise
    _remove(old)

  def discard(self) -> None:
    """Remove the temporary file or folder; the target is unchanged."""
    _remove(self.temporary)
    _WRITING.discard(self.temporary)

  def __enter__(self) -> Path:
    return self.temporary

  def __exit__(
    self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
  ) -> None:
    if error is None:
      self.commit()
    else:
      self.discard()


def remove_leftovers(folder: str | os.PathLike[str]) -> list[Path]:
  """Remove temporary files that killed processes left anywhere in a folder; return their paths.

  A file is left over if its process on this host has ended, or if it has not changed for a day.
  """
  removed: list[Path] = []
  with contextlib.suppress(OSError):
    for path in Path(folder).rglob(".*.tmp*"):
      if (match := _TEMPORARY.fullmatch(path.name)) and _is_left_over(path, match["host"], int(match["pid"])):
        _remove(path)
        removed.append(path)
  return removed


@contextlib.contextmanager
def reading(what: str, path: str | os.PathLike[str], max_bytes: int | None = None) -> Generator[Path]:
  """Turn a failure to read a file into an error of one line with the file's name.

  Args:
    what: Kind of the file, such as "checkpoint".
    path: The file.
    max_bytes: Largest size that is read.

  Raises:
    FileError: The file does not exist, is too large, or made the code inside fail.
  """
  prefix = f"{what} {printable(path, 300)}"
  try:
    size = os.stat(path).st_size
    if max_bytes is not None and size > max_bytes:
      raise FileError(f"{size / 2**20:.0f} MiB is more than the {max_bytes / 2**20:.0f} MiB that such a file may have")
    yield Path(path)
  except MjlabError as error:
    raise FileError(str(error) if str(error).startswith(prefix) else f"{prefix}: {printable(error, 1000)}") from error
  except FileNotFoundError as error:
    raise FileError(f"{prefix}: no such file") from error
  except RecursionError as error:
    raise FileError(f"{prefix}: nested too deeply") from error
  except KeyError as error:
    raise FileError(f"{prefix}: lacks {printable(error, 200)}") from error
  except Exception as error:
    reason = printable(getattr(error, "strerror", None) or error, 500) or type(error).__name__
    raise FileError(f"{prefix}: {reason}") from error


def safe_name(text: str) -> str:
  """Return a file name made from `text`, which may come from a file.

  Letters, digits, ".", "-" and "_" are kept; path separators and all other characters become "_". The name is one path
  component, not hidden, not empty, and at most 120 bytes long. A name that is safe already is returned unchanged.
  """
  parts = [part for part in re.split(r"[/\\]+", unicodedata.normalize("NFC", text)) if part.strip(".")]
  name = re.sub(r"[^\w.-]+", "_", "_".join(parts))
  name = name.encode()[:_MAX_NAME_BYTES].decode(errors="ignore").lstrip(".-").rstrip(".")
  return name or "unnamed"


def printable(text: object, limit: int = 500) -> str:
  """Return `text` on one line without control characters, cut to `limit` characters.

  Line breaks and tabs become spaces. Escape sequences and characters that reverse the direction of writing lose their
  effect.
  """
  line = " ".join(str(text).split())
  line = "".join(character for character in line if character.isprintable())
  return line if len(line) <= limit else f"{line[: limit - 3]}..."


def _host() -> str:
  return re.sub(r"[^\w-]+", "-", socket.gethostname())[:40]


def _is_left_over(path: Path, host: str, pid: int) -> bool:
  if path in _WRITING:
    return False
  if host == _host() and (pid == os.getpid() or not _is_alive(pid)):
    return True
  try:
    return time.time() - path.stat().st_mtime > _ABANDONED
  except OSError:
    return False


def _is_alive(pid: int) -> bool:
  if os.name == "nt":
    # Signal 0 is Ctrl-C there.
    return True
  try:
    os.kill(pid, 0)
  except (ProcessLookupError, OverflowError):
    return False
  except OSError:
    # The process belongs to another user.
    return True
  return True


def _remove(path: Path) -> None:
  with contextlib.suppress(OSError):
    if path.is_dir() and not path.is_symlink():
      shutil.rmtree(path)
    else:
      path.unlink(missing_ok=True)


def _sync(path: Path) -> None:
  """Write a file or the names in a folder to the disk, where the system allows that."""
  try:
    handle = os.open(path, os.O_RDONLY)
  except OSError:
    # Some systems cannot open folders.
    if path.is_dir():
      return
    raise
  try:
    with contextlib.suppress(OSError) if path.is_dir() else contextlib.nullcontext():
      os.fsync(handle)
  finally:
    os.close(handle)
