"""NumPy archives from untrusted sources: sizes are read before data, and nothing in them runs."""

import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from mjlab_deploy.errors import DeployError, reading

Arrays = dict[str, np.ndarray]

_KINDS = ("<f4", "<f8", "<i4", "<i8", "|b1", "|u1", "|i1")
_MAX_HEADER = 4096
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_arrays(path: Path, max_bytes: int) -> Arrays:
  """Return the arrays of an .npz file by name.

  Args:
    path: The file.
    max_bytes: Largest size of all arrays together.

  Raises:
    DeployError: It is damaged, too large, or holds anything but plain numbers.
  """
  found: Arrays = {}
  left = max_bytes
  with reading(path.name, Exception), zipfile.ZipFile(path) as archive:
    for record in archive.infolist():
      with archive.open(record) as file:
        dtype, shape = _header(file)
        size = dtype.itemsize * math.prod(shape)
        if (left := left - size) < 0:
          raise DeployError(f"holds more than {max_bytes >> 20} MiB")
        # One byte more shows that the header is wrong.
        data = file.read(size + 1)
      found[record.filename.removesuffix(".npy")] = np.frombuffer(data, dtype).reshape(shape)
  return found


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
  """Write arrays by name into an .npz file that `read_arrays` takes."""
  whole: dict[str, Any] = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
  with path.open("wb") as file:
    np.savez_compressed(file, **whole)


def _header(file: IO[bytes]) -> tuple[np.dtype, tuple[int, ...]]:
  read_header = _HEADERS[np.lib.format.read_magic(file)]
  shape, is_fortran, dtype = read_header(file, max_header_size=_MAX_HEADER)
  if dtype.str not in _KINDS or is_fortran or min(shape, default=0) < 0:
    raise DeployError(f"holds an array of type {dtype.str[:20]!r} and shape {shape}; allowed: {', '.join(_KINDS)}")
  return dtype, shape
