"""Records of a motor, read from CSV files: what it was told, where it was, and what it gave."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from mjlab_core.names import unknown

COLUMNS = {
  "time": "when the row was taken [s]",
  "position_target": "set-point of the position [m or rad]",
  "position": "measured position [m or rad]",
  "velocity": "measured velocity [m/s or rad/s]",
  "effort": "what the motor gave from this row to the next [N or N m]",
}
"""Columns that a file of records must have, by name."""

SEGMENT = "segment"
"""Optional column: rows with the same text in a row belong together, and time may begin anew where it changes."""

# Clocks jitter; a sample may be late by this share of the period.
_JITTER = 0.1


class RecordsError(ValueError):
  """Records that cannot be used; the message says which file, line and column."""


@dataclass(frozen=True, kw_only=True)
class Records:
  """Uninterrupted stretches of one motor at one sample period."""

  period: float
  """Time between two rows [s]."""
  segments: tuple[np.ndarray, ...]
  """One table per stretch, (rows, 4): position target, position, velocity, effort."""
  ignored: tuple[str, ...] = ()
  """Columns of the files that were not read."""

  @property
  def num_rows(self) -> int:
    """Rows of all segments."""
    return sum(len(segment) for segment in self.segments)


def read_records(paths: Sequence[str | Path]) -> Records:
  """Records from CSV files with a header line that has at least the `COLUMNS`, in any order; a file begins a segment.

  Raises:
    RecordsError: A file is missing, empty or no text, a column is missing or there twice, a line has another number of
      fields than the header, a value is no finite number, or samples are not taken at one period.
  """
  if not paths:
    raise RecordsError("no file of records is given")
  segments: list[np.ndarray] = []
  starts: list[tuple[Path, list[int]]] = []
  ignored: dict[str, None] = {}
  for path in map(Path, paths):
    rows, lines, names, others = _read(path)
    ignored |= dict.fromkeys(others)
    bounds = [0, *(i for i in range(1, len(rows)) if names[i] != names[i - 1]), len(rows)]
    for begin, end in pairwise(bounds):
      segments.append(np.array(rows[begin:end]))
      starts.append((path, lines[begin:end]))
  steps = [np.diff(segment[:, 0]) for segment in segments]
  if not any(step.size for step in steps):
    raise RecordsError(f"{starts[0][0]}: no segment has two rows, so there is no sample period")
  every = np.concatenate(steps)
  period = float(np.median(every))
  for (path, lines), step in zip(starts, steps, strict=True):
    wrong = np.flatnonzero(np.abs(step - period) > _JITTER * abs(period)) if period > 0.0 else np.arange(step.size)
    if wrong.size:
      raise RecordsError(
        f"{path}, line {lines[wrong[0] + 1]}, column 'time': {step[wrong[0]]:g} s after the row before, while rows are "
        f"{period:g} s apart; resample the records, or begin a new '{SEGMENT}' where they were interrupted"
      )
  # Written times are rounded; over many rows that averages out.
  period = _rounded(float(every.mean()))
  return Records(period=period, segments=tuple(s[:, 1:] for s in segments), ignored=tuple(ignored))


def _read(path: Path) -> tuple[list[list[float]], list[int], list[str], list[str]]:
  """Numbers by `COLUMNS`, line number and segment of every row of a file; and the columns that it has besides."""
  try:
    with path.open(newline="", encoding="utf-8-sig") as file:
      reader = csv.reader(file)
      header = [name.strip() for name in next(reader, [])]
      places = _places(path, header)
      rows, lines, names = [], [], []
      for fields in reader:
        line = reader.line_num
        if not fields:
          continue
        if len(fields) != len(header):
          raise RecordsError(f"{path}, line {line}: {len(fields)} fields, but the header has {len(header)}")
        rows.append([_number(path, line, name, fields[places[name]]) for name in COLUMNS])
        lines.append(line)
        names.append(fields[places[SEGMENT]].strip() if SEGMENT in places else "")
  except OSError as error:
    raise RecordsError(f"{path}: {error.strerror or error}") from error
  except UnicodeDecodeError as error:
    raise RecordsError(f"{path}: not a text file in UTF-8") from error
  except csv.Error as error:
    raise RecordsError(f"{path}: not a CSV file: {error}") from error
  if not rows:
    raise RecordsError(f"{path}: no rows below the header")
  return rows, lines, names, [name for name in header if name not in places]


def _places(path: Path, header: list[str]) -> dict[str, int]:
  if not any(header):
    raise RecordsError(f"{path}: empty; the first line names the columns: {','.join(COLUMNS)}")
  for name in COLUMNS:
    if name not in header:
      raise RecordsError(unknown("column", name, header, owner=f"{path}, line 1"))
  places = {name: header.index(name) for name in (*COLUMNS, SEGMENT) if name in header}
  for name in places:
    if header.count(name) > 1:
      raise RecordsError(f"{path}, line 1: column '{name}' is there {header.count(name)} times")
  return places


def _number(path: Path, line: int, name: str, text: str) -> float:
  try:
    value = float(text)
  except ValueError:
    value = math.nan
  if not math.isfinite(value):
    raise RecordsError(f"{path}, line {line}, column '{name}': {text.strip()!r} is not a finite number")
  return value


def _rounded(period: float) -> float:
  """Without the noise of subtracted decimals, so that it can equal a timestep."""
  return float(f"{period:.6g}")
