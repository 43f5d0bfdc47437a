"""Reading of records from CSV, NumPy and MCAP files."""

import csv
import math
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from mjlab_core.errors import FileError
from mjlab_core.files import printable, reading
from mjlab_core.names import unknown

from mjlab_sysid._mcap import read_mcap
from mjlab_sysid.records import BODY_SIGNALS, JOINT_SIGNALS, UNITS, Record, elements

MAX_BYTES = 2**30
"""Largest file of records that is read."""

_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_MAX_HEADER = 4096
_MAX_ARRAYS = 64


def read_records(paths: Sequence[str | Path]) -> list[Record]:
  """Read records from CSV, NumPy and MCAP files; the documentation of mjlab-sysid describes their layout.

  Raises:
    FileError: A file is missing, too large or damaged, a name or unit is unknown, time does not rise, or a value is not
      a finite number.
    ModuleNotFoundError: An MCAP file is given without the extra 'mcap'.
  """
  if not paths:
    raise FileError("no file of records is given")
  found: list[Record] = []
  for path in map(Path, paths):
    with reading("record", path, MAX_BYTES):
      if path.suffix not in _READERS:
        raise FileError(f"expected a name that ends in {', '.join(_READERS)}")
    found += _READERS[path.suffix](path)
  return found


_COLUMN = re.compile(r"\s*(?P<signal>[a-z_]+)(/(?P<element>[^\[]*?))?\s*(\[(?P<unit>[^\]]*)\])?\s*")
_SEGMENT = "segment"


def factor(quantity: str, unit: str | None, owner: str) -> float:
  """Return the factor from a unit to SI.

  Raises:
    FileError: The unit does not exist.
  """
  known = UNITS[quantity]
  if unit is not None and unit not in known:
    raise FileError(unknown(f"unit of {quantity}", printable(unit, 40), known, owner=owner))
  return 1.0 if unit is None else known[unit]


def _read_csv(path: Path) -> list[Record]:
  with reading("record", path), path.open(newline="", encoding="utf-8-sig") as file:
    reader = csv.reader(file)
    header = [printable(name, 120) for name in next(reader, [])]
    ignored: list[str] = []
    columns = list(_parsed(header, ignored))
    if ("time", None) not in [key for key, _, _ in columns]:
      raise FileError(unknown("column", "time", header, owner="line 1"))
    segment = header.index(_SEGMENT) if _SEGMENT in header else None
    rows: list[list[float]] = []
    segments: list[str] = []
    for fields in reader:
      if not fields:
        continue
      line = reader.line_num
      if len(fields) != len(header):
        raise FileError(f"line {line}: {len(fields)} fields, but the header has {len(header)}")
      rows.append([_number(line, header[place], fields[place]) for _, place, _ in columns])
      segments.append(fields[segment].strip() if segment is not None else "")
    if not rows:
      raise FileError("no rows below the header")
    table = np.array(rows) * [scale for _, _, scale in columns]
    bounds = [0, *(i for i in range(1, len(rows)) if segments[i] != segments[i - 1]), len(rows)]
    keys = [key for key, _, _ in columns]
    parts = []
    for begin, end in pairwise(bounds):
      name = printable(path, 200) + (f", segment {printable(segments[begin], 40)}" if segment is not None else "")
      parts.append(_from_columns(name, dict(zip(keys, table[begin:end].T, strict=True)), tuple(ignored)))
    return parts


_Key = tuple[str, str | None]


def _parsed(header: Sequence[str], ignored: list[str]) -> Iterator[tuple[_Key, int, float]]:
  """Signal and element, place, and factor of the columns that are read; the others are added to `ignored`."""
  known = ("time", *JOINT_SIGNALS, *BODY_SIGNALS)
  seen: set[_Key] = set()
  for place, text in enumerate(header):
    if text == _SEGMENT:
      continue
    match = _COLUMN.fullmatch(text)
    if match is None or match["signal"] not in known:
      ignored.append(text)
      continue
    signal, element = match["signal"], match["element"]
    quantity = "time" if signal == "time" else (JOINT_SIGNALS | BODY_SIGNALS)[signal]
    key = (signal, None if signal == "time" else element or "joint")
    if key in seen:
      raise FileError(f"line 1: column '{text}' is there twice")
    seen.add(key)
    yield key, place, factor(quantity, match["unit"], f"line 1, column '{text}'")


def _from_columns(source: str, columns: Mapping[_Key, np.ndarray], ignored: tuple[str, ...]) -> Record:
  time = columns["time", None]
  joints = tuple(dict.fromkeys(element for signal, element in columns if signal in JOINT_SIGNALS and element))
  absent = np.full_like(time, np.nan)
  signals = {
    name: np.stack([columns.get((name, element), absent) for element in elements(name, joints)], 1)
    for name in (*JOINT_SIGNALS, *BODY_SIGNALS)
    if any(signal == name for signal, _ in columns)
  }
  if not joints:
    raise FileError(f"no column of a joint; columns are named '{next(iter(JOINT_SIGNALS))}/JOINT' and so on")
  return Record(source=source, joints=joints, time=time, signals=signals, ignored=ignored)


def _number(line: int, name: str, text: str) -> float:
  try:
    value = float(text)
  except ValueError:
    value = math.nan
  if not math.isfinite(value):
    raise FileError(f"line {line}, column '{name}': {printable(text, 40)!r} is not a finite number")
  return value


def _read_npz(path: Path) -> list[Record]:
  with reading("record", path):
    arrays = _read_arrays(path, MAX_BYTES)
    for name in ("time", "joints"):
      if name not in arrays:
        raise FileError(unknown("array", name, arrays))
    joints = tuple(printable(name, 120) for name in arrays.pop("joints").reshape(-1).tolist())
    units = arrays.pop("units", np.zeros(0, dtype=str)).reshape(-1).tolist()
    scale = {}
    for text in map(str, units):
      signal, _, unit = text.partition("=")
      quantity = "time" if signal == "time" else (JOINT_SIGNALS | BODY_SIGNALS).get(signal)
      if quantity is None:
        raise FileError(unknown("signal", printable(signal, 80), (*JOINT_SIGNALS, *BODY_SIGNALS), owner="units"))
      scale[signal] = factor(quantity, unit, f"units of '{signal}'")
    known = [name for name in arrays if name in ("time", *JOINT_SIGNALS, *BODY_SIGNALS)]
    for name in known:
      if arrays[name].dtype.kind not in "fiu":
        raise FileError(f"array '{name}' holds {arrays[name].dtype}, expected numbers")
    numbers = {name: arrays[name].astype(np.float64) * scale.get(name, 1.0) for name in known}
    time = numbers.pop("time").reshape(-1)
    ignored = tuple(name for name in arrays if name not in known)
    return [Record(source=printable(path, 200), joints=joints, time=time, signals=numbers, ignored=ignored)]


def _read_mcap(path: Path) -> list[Record]:
  return [read_mcap(path)]


_READERS = {".csv": _read_csv, ".npz": _read_npz, ".mcap": _read_mcap}


def _read_arrays(path: Path, max_bytes: int) -> dict[str, np.ndarray]:
  """Return the arrays of an .npz file by name; sizes are read before data, and nothing in it runs.

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
