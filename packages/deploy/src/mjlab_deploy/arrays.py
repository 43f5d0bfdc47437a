"""NumPy archives from strangers: sizes are read before data, and nothing in them runs."""

import ast
import math
import struct
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import numpy as np

from mjlab_deploy.errors import DeployError

Arrays = dict[str, np.ndarray]

_KINDS = ("<f4", "<f8", "<i4", "<i8", "|b1", "|u1", "|i1")
_MAX_HEADER = 4096


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
  try:
    with zipfile.ZipFile(path) as archive:
      for record in archive.infolist():
        with archive.open(record) as file:
          dtype, shape = _header(file)
          size = dtype.itemsize * math.prod(shape)
          if (left := left - size) < 0:
            raise DeployError(f"holds more than {max_bytes >> 20} MiB")
          data = file.read(size + 1)
        if len(data) != size:
          raise DeployError(f"{record.filename!r} has {len(data)} bytes, its header says {size}")
        found[record.filename.removesuffix(".npy")] = np.frombuffer(data, dtype).reshape(shape)
  except DeployError as error:
    raise DeployError(f"{path.name}: {error}") from error
  except (
    OSError,
    ValueError,
    SyntaxError,
    zipfile.BadZipFile,
    struct.error,
    NotImplementedError,
    RuntimeError,
  ) as error:
    raise DeployError(f"{path.name}: damaged ({str(error)[:120]})") from error
  return found


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
  """Write arrays by name into an .npz file that `read_arrays` takes."""
  with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
    for name, array in arrays.items():
      with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        np.lib.format.write_array(file, np.ascontiguousarray(array), version=(1, 0), allow_pickle=False)


def _header(file: IO[bytes]) -> tuple[np.dtype, tuple[int, ...]]:
  magic = file.read(8)
  if magic[:6] != b"\x93NUMPY" or magic[6] not in (1, 2):
    raise DeployError("holds something that is not an array")
  width = 2 if magic[6] == 1 else 4
  (length,) = struct.unpack("<H" if width == 2 else "<I", file.read(width))
  if length > _MAX_HEADER:
    raise DeployError("has a header that is too long")
  header = ast.literal_eval(file.read(length).decode("latin1"))
  kind, shape = header["descr"], header["shape"]
  if kind not in _KINDS or header["fortran_order"]:
    raise DeployError(f"holds numbers of type {str(kind)[:20]!r}; allowed: {', '.join(_KINDS)}")
  if len(shape) > 8 or not all(isinstance(n, int) and n >= 0 for n in shape):
    raise DeployError("has an impossible shape")
  return np.dtype(kind), shape
