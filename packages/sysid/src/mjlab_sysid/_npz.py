"""NumPy archives from others: sizes are read before data, and nothing in them runs."""

import math
import zipfile
from pathlib import Path

import numpy as np
from mjlab_core.errors import FileError
from mjlab_core.files import printable

_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_MAX_HEADER = 4096
_MAX_ARRAYS = 64


def read_arrays(path: Path, max_bytes: int) -> dict[str, np.ndarray]:
  """Return the arrays of an .npz file by name.

  Raises:
    FileError: The archive is damaged, larger than `max_bytes`, or holds objects.
  """
  if not zipfile.is_zipfile(path):
    raise FileError("not a NumPy archive")
  found: dict[str, np.ndarray] = {}
  left = max_bytes
  with zipfile.ZipFile(path) as archive:
    if len(archive.infolist()) > _MAX_ARRAYS:
      raise FileError(f"holds {len(archive.infolist())} arrays, more than {_MAX_ARRAYS}")
    for info in archive.infolist():
      name = printable(info.filename.removesuffix(".npy"), 80)
      with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        if version not in _HEADERS:
          raise FileError(f"array '{name}' has format {version}, expected 1.0 or 2.0")
        shape, is_fortran, dtype = _HEADERS[version](file, max_header_size=_MAX_HEADER)
        size = dtype.itemsize * math.prod(shape)
        if dtype.kind not in "fiuU" or is_fortran:
          raise FileError(f"array '{name}' holds {dtype}, expected numbers or text in C order")
        if size > left:
          raise FileError(f"more than {max_bytes >> 20} MiB of arrays")
        left -= size
        data = file.read(size + 1)
      if len(data) != size:
        raise FileError(f"array '{name}' has {len(data)} bytes, its header says {size}")
      found[name] = np.frombuffer(data, dtype).reshape(shape)
  return found
