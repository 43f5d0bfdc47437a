"""Reading of records from CSV, NumPy and MCAP files."""

import csv
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
from mjlab_core.errors import FileError
from mjlab_core.io.files import printable, reading
from mjlab_core.io.npz import Npz
from mjlab_core.names import check_name, unknown

from mjlab_sysid.data._mcap import read_mcap
from mjlab_sysid.data.records import JOINT_SIGNALS, QUANTITIES, SIGNALS, UNITS, Record, elements

MAX_BYTES = 2**30
"""Largest file of records that is read."""


def read_records(paths: Sequence[str | Path]) -> list[Record]:
  """Read records from CSV, NumPy and MCAP files; the documentation of mjlab-sysid describes their layout.

  Raises:
    FileError: A file is missing, too large or damaged, a name or unit is unknown, time does not rise, or a value is not
      a finite number.
    ModuleNotFoundError: An MCAP file is given without the extra 'mcap'.
  """
  found: list[Record] = []
  for path in map(Path, paths):
    with reading("record", path, MAX_BYTES):
      read = _READERS[check_name("ending", path.suffix, _READERS)]
    found += read(path)
  return found


_COLUMN = re.compile(r"\s*(?P<signal>[a-z_]+)(/(?P<element>[^\[]*?))?\s*(\[(?P<unit>[^\]]*)\])?\s*")
_SEGMENT = "segment"
_Key = tuple[str, str | None]


def factor(signal: str, unit: str | None, owner: str) -> float:
  """Return the factor from the unit of a signal to SI.

  Raises:
    FileError: The unit does not exist.
  """
  quantity = QUANTITIES[signal]
  return 1.0 if unit is None else UNITS[quantity][check_name(f"unit of {quantity}", unit, UNITS[quantity], owner)]


def _read_csv(path: Path) -> list[Record]:
  with reading("record", path), path.open(newline="", encoding="utf-8-sig") as file:
    reader = csv.reader(file)
    header = [printable(name, 120) for name in next(reader, [])]
    columns, ignored = _parsed(header)
    if ("time", None) not in columns:
      raise FileError(unknown("column", "time", header, owner="line 1"))
    rows: list[list[float]] = []
    segments: list[str] = []
    for fields in filter(None, reader):
      if len(fields) != len(header):
        raise FileError(f"line {reader.line_num}: {len(fields)} fields, but the header has {len(header)}")
      rows.append([_number(reader.line_num, header[place], fields[place]) for place, _ in columns.values()])
      segments.append(fields[header.index(_SEGMENT)].strip() if _SEGMENT in header else "")
    if not rows:
      raise FileError("no rows below the header")
    table = np.array(rows) * [scale for _, scale in columns.values()]
    bounds = [0, *(i for i in range(1, len(rows)) if segments[i] != segments[i - 1]), len(rows)]
    parts = []
    for begin, end in pairwise(bounds):
      name = printable(path, 200) + (f", segment {printable(segments[begin], 40)}" if _SEGMENT in header else "")
      parts.append(_from_columns(name, dict(zip(columns, table[begin:end].T, strict=True)), ignored))
    return parts


def _parsed(header: Sequence[str]) -> tuple[dict[_Key, tuple[int, float]], tuple[str, ...]]:
  """Return place and factor of each column that is read, by signal and element, and the names of the others."""
  columns: dict[_Key, tuple[int, float]] = {}
  ignored = []
  for place, text in enumerate(header):
    match = _COLUMN.fullmatch(text)
    if match is None or match["signal"] not in QUANTITIES:
      ignored += [text] * (text != _SEGMENT)
      continue
    signal = match["signal"]
    key = (signal, None if signal == "time" else match["element"] or "joint")
    if key in columns:
      raise FileError(f"line 1: column '{text}' is there twice")
    columns[key] = place, factor(signal, match["unit"], f"line 1, column '{text}'")
  return columns, tuple(ignored)


def _from_columns(source: str, columns: Mapping[_Key, np.ndarray], ignored: tuple[str, ...]) -> Record:
  time = columns["time", None]
  joints = tuple(dict.fromkeys(element for signal, element in columns if signal in JOINT_SIGNALS and element))
  if not joints:
    raise FileError(f"no column of a joint; columns are named '{next(iter(JOINT_SIGNALS))}/JOINT' and so on")
  absent = np.full_like(time, np.nan)
  signals = {
    name: np.stack([columns.get((name, element), absent) for element in elements(name, joints)], 1)
    for name in dict.fromkeys(signal for signal, _ in columns if signal != "time")
  }
  return Record(source=source, joints=joints, time=time, signals=signals, ignored=ignored)


def _number(line: int, name: str, text: str) -> float:
  with suppress(ValueError):
    if math.isfinite(value := float(text)):
      return value
  raise FileError(f"line {line}, column '{name}': {printable(text, 40)!r} is not a finite number")


def _read_npz(path: Path) -> list[Record]:
  with reading("record", path):
    archive = Npz(path, MAX_BYTES)
    scale = dict.fromkeys(QUANTITIES, 1.0)
    for text in archive.words("units") if "units" in archive else ():
      signal, _, unit = printable(text, 80).partition("=")
      scale[signal] = factor(check_name("signal", signal, QUANTITIES, "units"), unit, f"units of '{signal}'")
    time, joints = archive.column("time"), archive.words("joints")
    signals = {name: archive.numbers(name, ndim=2) * scale[name] for name in archive if name in SIGNALS}
    return [
      Record(
        source=printable(path, 200),
        joints=tuple(printable(name, 120) for name in joints),
        time=time * scale["time"],
        signals=signals,
        ignored=tuple(printable(name, 80) for name in archive if name not in (*QUANTITIES, "joints", "units")),
      )
    ]


_READERS = {".csv": _read_csv, ".npz": _read_npz, ".mcap": read_mcap}
