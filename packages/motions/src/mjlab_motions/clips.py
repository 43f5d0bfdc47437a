"""Files of clips by name: those that ship with mjlab-motions, motion files, folders of them, and texts beside them."""

import dataclasses
import os
from importlib.resources import files
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
from mjlab_core.errors import FileError, UnknownNameError
from mjlab_core.io.files import reading
from mjlab_core.names import check_name, unknown

T = TypeVar("T")
MAX_BYTES = 512 * 2**20
"""Limit of a file, and of all numbers that are read from one [bytes]; 90 minutes of a G1 with its bodies."""
MAX_TEXT_BYTES = 2**20
"""Limit of a text beside a clip, such as a joint map [bytes]."""
INDEX = "library.json"
"""Optional file of a folder: {"clip.npz": {"weight": 2.0, "split": "test"}, ...}."""


class _Settings(msgspec.Struct, forbid_unknown_fields=True):
  weight: Annotated[float, msgspec.Meta(gt=0.0)] = 1.0
  split: str = "train"


@dataclasses.dataclass(frozen=True, kw_only=True)
class ClipEntry:
  """Clip of a library before it is placed on a robot."""

  path: Path
  weight: float = 1.0
  """Probability that an episode starts at a moment of this clip, relative to moments of other clips."""
  split: str = "train"


def shipped_clips() -> dict[str, Path]:
  """Return the clips of this package by name."""
  folder = Path(str(files("mjlab_motions") / "clips"))
  return {path.stem: path for path in sorted(folder.glob("*.npz"))}


def find_clips(motion: str, split: str | None = None) -> list[ClipEntry]:
  """Return the clips that a name refers to.

  Args:
    motion: Name of a clip that ships, path of a motion file, or path of a folder of them.
    split: Split of a folder whose clips are returned; None: all clips.

  Raises:
    UnknownNameError: No clip, file or folder has that name.
    FileError: The folder has no clips of the split, or its index is wrong.
  """
  shipped, path = shipped_clips(), Path(motion)
  if motion in shipped:
    return [ClipEntry(path=shipped[motion])]
  if path.is_dir():
    entries = _folder(path)
    chosen = [entry for entry in entries if split is None or entry.split == split]
    if not chosen:
      splits = ", ".join(sorted({entry.split for entry in entries}))
      raise FileError(f"{path}: no clip of split '{split}'; there is: {splits}" if entries else f"{path}: has no .npz")
    return chosen
  if path.is_file():
    if path.suffix != ".npz":
      raise FileError(f"{path}: a clip to follow is an .npz; `convert-motion {path} --output FILE.npz` makes one")
    return [ClipEntry(path=path)]
  raise UnknownNameError(f"{unknown('motion', motion, shipped)} It may also be the path of an .npz or of a folder.")


def _folder(folder: Path) -> list[ClipEntry]:
  paths = {path.name: path for path in sorted(folder.glob("*.npz"))}
  index: dict[str, _Settings] = {}
  if (file := folder / INDEX).is_file():
    index = read_json(file, dict[str, _Settings], '{"clip.npz": {"weight": 1.0, "split": "train"}, ...}')
  for name in index:
    check_name("clip", name, paths, str(file))
  settings = {name: msgspec.structs.asdict(index.get(name, _Settings())) for name in paths}
  return [ClipEntry(path=path, **settings[name]) for name, path in paths.items()]


def read_text(path: str | os.PathLike[str]) -> str:
  """Return the text of a small file in UTF-8.

  Raises:
    FileError: There is no such file, it is larger than `MAX_TEXT_BYTES`, or it is not a text.
  """
  with reading("text", path, MAX_TEXT_BYTES) as file:
    return file.read_text(encoding="utf-8-sig")


def read_json(path: str | os.PathLike[str], kind: type[T], example: str) -> T:
  """Return the contents of a JSON file, converted to a type of msgspec.

  Raises:
    FileError: See `read_text`; or the contents are of another type than the example.
  """
  try:
    return msgspec.json.decode(read_text(path), type=kind)
  except (msgspec.DecodeError, RecursionError) as error:
    raise FileError(f"{path}: {error}; expected {example}") from error
