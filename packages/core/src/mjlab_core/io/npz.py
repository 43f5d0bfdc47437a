"""Arrays of untrusted `.npz` files: sizes are checked first, and only requested arrays are unpacked."""

from __future__ import annotations

import io
import math
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mjlab_core.errors import FileError
from mjlab_core.io.files import printable

if TYPE_CHECKING:
  from numpy.typing import NDArray

MAX_TEXT_BYTES = 2**20
"""Limit of a text, or of a list of names, in a file [bytes]."""
_MAX_HEADER = 10_000
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_PLAIN = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


class Npz:
  """Arrays of a `.npz`, each unpacked when it is asked for. Nothing in the file is executed.

  It is used inside `reading`, which limits the size of the file and names it in messages.

  Args:
    path: The file.
    max_bytes: Limit of all numbers that are read from it.
  """

  def __init__(self, path: str | os.PathLike[str], max_bytes: int) -> None:
    self.path = Path(path)
    with zipfile.ZipFile(self.path) as archive:
      members = archive.infolist()
    self._members = {info.filename.removesuffix(".npy"): info for info in members if info.filename.endswith(".npy")}
    self._max_bytes = self._left = max_bytes

  @property
  def names(self) -> str:
    """Names of the arrays, for messages."""
    return printable(", ".join(self._members)) or "nothing"

  def __iter__(self) -> Iterator[str]:
    """Yield the names of the arrays as they are in the file."""
    return iter(self._members)

  def numbers(self, name: str, *, ndim: int) -> NDArray[np.float64]:
    """Return an array of numbers with `ndim` axes.

    Raises:
      FileError: It is missing, damaged or too large, holds something else, or has other axes.
    """
    value = self._array(name, "fiu", ndim, f"{ndim}-d numbers")
    return value.astype(np.float64)

  def column(self, name: str) -> NDArray[np.float64]:
    """Return all numbers of an array in one row, whatever axes it has.

    Raises:
      FileError: It is missing, damaged or too large, or holds something else.
    """
    return self._array(name, "fiu", None, "numbers").reshape(-1).astype(np.float64)

  def number(self, name: str) -> float:
    """Return the one number of an array.

    Raises:
      FileError: See `column`; or it holds several.
    """
    values = self.column(name)
    if values.size != 1:
      raise FileError(f"{name} has {values.size} numbers, expected one")
    return float(values[0])

  def words(self, name: str) -> tuple[str, ...]:
    """Return a list of words.

    Raises:
      FileError: It is missing, damaged or too large, or not a list of words.
    """
    return tuple(self._array(name, "US", 1, "a list of names").astype(str).tolist())

  def text(self, name: str) -> str:
    """Return a text.

    Raises:
      FileError: It is missing, damaged or too large, or not a text.
    """
    return str(self._array(name, "U", 0, "a text").item())

  def _array(self, name: str, kinds: str, ndim: int | None, expected: str) -> np.ndarray:
    if name not in self._members:
      raise FileError(f"lacks {name}, it has: {self.names}")
    info, is_numeric = self._members[name], "f" in kinds
    if info.compress_type not in _PLAIN or info.flag_bits & 1:
      raise FileError(f"{name} is encrypted or uses a compression that NumPy does not write")
    try:
      with zipfile.ZipFile(self.path) as archive, archive.open(info) as member:
        shape, dtype = _header(member.read(_MAX_HEADER))
        fits = dtype.kind in kinds and ndim in (None, len(shape))
        # Numbers become float64.
        size = math.prod(shape) * (max(dtype.itemsize, 8) if is_numeric else dtype.itemsize)
        if fits and size <= (self._left if is_numeric else MAX_TEXT_BYTES):
          self._left -= size
          with archive.open(info) as member:
            return np.lib.format.read_array(member, allow_pickle=False, max_header_size=_MAX_HEADER)
    except Exception as error:  # zipfile, zlib and NumPy each have their own errors
      raise FileError(f"{name} is not a readable array ({printable(error)})") from error
    if dtype.hasobject:
      raise FileError(f"{name} holds Python objects, which are not read")
    if not fits:
      raise FileError(f"{name} has shape {shape} and type {dtype}, expected {expected}")
    limit = f"all numbers of a file {self._max_bytes >> 20} MiB" if is_numeric else f"a text {MAX_TEXT_BYTES >> 20} MiB"
    raise FileError(f"{name} unpacks to {size >> 20} MiB; the limit is for {limit}")


def _header(start: bytes) -> tuple[tuple[int, ...], np.dtype]:
  """Return shape and type of an array from the beginning of its `.npy`."""
  stream = io.BytesIO(start)
  shape, _, dtype = _HEADERS[np.lib.format.read_magic(stream)](stream, max_header_size=_MAX_HEADER)
  return shape, dtype
