"""Records of a robot: commands and measurements of its joints over time, by name and in SI units."""

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from mjlab_core.errors import FileError
from mjlab_core.io.files import AtomicWrite, printable
from mjlab_core.names import check_name, match_names, unknown

JOINT_SIGNALS: dict[str, str] = {
  "position_target": "position",
  "velocity_target": "velocity",
  "effort_target": "effort",
  "position": "position",
  "velocity": "velocity",
  "effort": "effort",
}
"""Quantity of each signal that joints have; targets are commands, the others are measured."""

BODY_SIGNALS: dict[str, str] = {
  "angular_velocity": "velocity",
  "linear_acceleration": "acceleration",
  "base_position": "length",
  "base_orientation": "quaternion",
}
"""Quantity of each signal of the IMU, in its own frame, (rows, 3), and of the pose of a base that moves, in the world:
its position, (rows, 3), and its unit quaternion, (rows, 4)."""


SIGNALS = (*JOINT_SIGNALS, *BODY_SIGNALS)
"""Names of all signals."""

QUANTITIES = {"time": "time", **JOINT_SIGNALS, **BODY_SIGNALS}
"""Quantity of time and of each signal."""


def elements(signal: str, joints: Sequence[str]) -> tuple[str, ...]:
  """Return the names of the columns of a signal."""
  if signal in JOINT_SIGNALS:
    return tuple(joints)
  return ("w", "x", "y", "z") if BODY_SIGNALS[signal] == "quaternion" else ("x", "y", "z")


def arranged(values: np.ndarray, joints: Sequence[str], order: Sequence[str]) -> np.ndarray:
  """Return columns of `joints`, (rows, joints), in the places of their names in `order`; NaN elsewhere."""
  out = np.full((len(values), len(order)), np.nan)
  out[:, [order.index(joint) for joint in joints]] = values
  return out


UNITS: dict[str, dict[str, float]] = {
  "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
  "position": {"rad": 1.0, "deg": math.pi / 180.0, "m": 1.0, "mm": 1e-3, "rev": 2.0 * math.pi},
  "velocity": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "m/s": 1.0, "mm/s": 1e-3, "rpm": math.pi / 30.0},
  "effort": {"N m": 1.0, "N": 1.0, "mN m": 1e-3},
  "acceleration": {"m/s^2": 1.0, "g": 9.80665},
  "length": {"m": 1.0, "mm": 1e-3},
  "quaternion": {"1": 1.0},
}
"""Factors to SI units by quantity; the first unit of each is the default."""

# A clock jitters; a sample may be late by this share of the period.
_JITTER = 0.1
# A longer interval, in periods, is an interruption.
_GAP = 3.5


@dataclass(frozen=True, kw_only=True)
class Record:
  """Signals of some joints at common times."""

  source: str
  """Name for messages, such as the file."""
  joints: tuple[str, ...]
  """Names of the joints, in the order of columns."""
  time: np.ndarray
  """Times of the rows, rising, (rows,) [s]."""
  signals: Mapping[str, np.ndarray] = field(repr=False)
  """Signals by name, (rows, joints, 3 or 4), in SI units; NaN where a joint lacks one."""
  ignored: tuple[str, ...] = ()
  """Columns or arrays of the file that were not read."""

  def __post_init__(self) -> None:
    if problem := next(self._problems(), ""):
      raise FileError(f"{self.source}{problem}")

  def _problems(self) -> Iterator[str]:
    """Yield descriptions of mistakes, to follow the source."""
    for name, values in self.signals.items():
      if name not in SIGNALS:
        yield f": {unknown('signal', printable(name, 80), SIGNALS)}"
      elif values.shape != (shape := (len(self.time), len(elements(name, self.joints)))):
        yield f": signal '{name}' is {values.shape}, expected {shape}"
    if len(set(self.joints)) < len(self.joints):
      yield f": a joint is there twice: {', '.join(self.joints)}"
    if len(self.time) < 2:
      yield f": {len(self.time)} rows; a record has at least two"
    rises = np.r_[True, self.time[1:] > self.time[:-1]] & np.isfinite(self.time)
    for row in np.flatnonzero(~rises):
      yield f", row {row + 1}: time {self.time[row]:g} s is not after that of the previous row; sort the rows"
    for name, values in self.signals.items():
      if name in BODY_SIGNALS and np.isnan(values).any():
        yield f": {name} is not finite, or lacks one of {', '.join(elements(name, ()))}"
      if name == "base_orientation" and not np.allclose(np.linalg.norm(values, axis=1), 1.0, atol=0.01):
        yield ": base_orientation is not a unit quaternion (w, x, y, z)"
      # A joint may lack a whole signal, but not single rows of it.
      for row, column in np.argwhere(~np.isfinite(values) & ~np.isnan(values).all(0)):
        yield f", row {row + 1}: {name} of '{elements(name, self.joints)[column]}' is not a finite number"

  @property
  def num_rows(self) -> int:
    """Number of rows."""
    return len(self.time)

  @property
  def period(self) -> float:
    """Time between two rows, the median [s]."""
    # Written times are rounded, which averages out over many rows.
    steps = np.diff(self.time)
    middle = float(np.median(steps))
    return float(f"{steps[np.abs(steps - middle) <= _JITTER * middle].mean():.6g}")

  def has(self, signal: str, joint: str) -> bool:
    """Return True if the joint has the signal."""
    return signal in self.signals and not np.isnan(self.signals[signal][0, self.joints.index(joint)])

  def of(self, signal: str, joints: Sequence[str]) -> np.ndarray:
    """Return a signal of some joints, (rows, len(joints)).

    Raises:
      FileError: A joint lacks the signal.
    """
    for joint in joints:
      if not self.has(signal, joint):
        others = f"; not read: {', '.join(self.ignored)}" if self.ignored else ""
        raise FileError(f"{self.source}: joint '{joint}' has no signal '{signal}'{others}")
    return self.signals[signal][:, [self.joints.index(joint) for joint in joints]]

  def rows(self, rows: slice) -> "Record":
    """Return a part of the record."""
    return replace(self, time=self.time[rows], signals={name: values[rows] for name, values in self.signals.items()})

  def select(self, patterns: str | Sequence[str]) -> "Record":
    """Return the record of the joints that a pattern matches.

    Raises:
      UnknownNameError: A pattern matches no joint.
    """
    columns, names = match_names(patterns, self.joints, what="joint", owner=self.source)
    signals = {name: v[:, columns] if name in JOINT_SIGNALS else v for name, v in self.signals.items()}
    return replace(self, joints=tuple(names), signals=signals)


def write_record(record: Record, path: str | Path) -> None:
  """Write a record as .npz or else as .csv; a file of that name is replaced whole."""
  path = Path(path)
  if path.suffix == ".npz":
    with AtomicWrite(path) as temporary, temporary.open("wb") as file:
      arrays: dict[str, Any] = {"time": record.time, "joints": np.array(record.joints, dtype=str), **record.signals}
      np.savez_compressed(file, **arrays)
    return
  columns = {"time": record.time}
  for name, values in record.signals.items():
    for element, column in zip(elements(name, record.joints), values.T, strict=True):
      if not np.isnan(column).all():
        columns[f"{name}/{element}"] = column
  with AtomicWrite(path) as temporary, temporary.open("w", encoding="utf-8") as file:
    file.write(",".join(columns) + "\n")
    np.savetxt(file, np.stack(list(columns.values()), 1), delimiter=",", fmt="%.9g")


def uniform(record: Record, period: float | None = None) -> list[Record]:
  """Return the uninterrupted stretches of a record, resampled to one period with a warning where it is uneven.

  Measurements are interpolated, targets are held. A gap of several periods begins a new stretch. Stretches of fewer
  than two rows are dropped.

  Args:
    record: Rows at any rising times.
    period: Wanted period [s]; None for the record's own.
  """
  own = record.period
  steps = np.diff(record.time)
  cuts = np.flatnonzero(steps > _GAP * own) + 1
  if cuts.size:
    longest = float(steps.max())
    warnings.warn(
      f"{record.source}: {cuts.size} gaps, the longest of {longest:.3g} s, while rows are {own:.3g} s apart; "
      "each begins a new stretch",
      stacklevel=2,
    )
  if np.any(np.abs(np.delete(steps, cuts - 1) - own) > _JITTER * own):
    share = float(np.mean(np.abs(steps - own) > _JITTER * own))
    warnings.warn(
      f"{record.source}: {share:.0%} of the rows are not {own:.3g} s apart; they are resampled", stacklevel=2
    )
  parts = [record.rows(slice(begin, end)) for begin, end in pairwise([0, *cuts, record.num_rows]) if end - begin >= 2]
  resampled = [_resampled(part, own if period is None else period) for part in parts]
  return [part for part in resampled if part is not None]


def _resampled(record: Record, period: float) -> Record | None:
  count = math.floor((record.time[-1] - record.time[0]) / period * (1.0 + 1e-9) + _JITTER) + 1
  if count < 2:
    return None
  time = record.time[0] + period * np.arange(count)
  if count == record.num_rows and np.all(np.abs(time - record.time) <= _JITTER * period):
    return replace(record, time=time)
  held = np.clip(np.searchsorted(record.time, time + _JITTER * period, side="right") - 1, 0, None)
  signals = {}
  for name, values in record.signals.items():
    is_held = name.endswith("_target")
    signals[name] = values[held] if is_held else interpolated(name, time, record.time, values)
  return replace(record, time=time, signals=signals)


def interpolated(name: str, time: np.ndarray, at: np.ndarray, values: np.ndarray) -> np.ndarray:
  """Return a signal, (rows, columns) at times `at`, at other times."""
  if name == "base_orientation":
    # q and -q are one orientation, but interpolation between them is not.
    signs = np.cumprod(np.where((values[1:] * values[:-1]).sum(1) < 0.0, -1.0, 1.0))
    values = np.concatenate((values[:1], values[1:] * signs[:, None]))
  out = np.stack([np.interp(time, at, column) for column in values.T], 1)
  return out / np.linalg.norm(out, axis=1, keepdims=True) if name == "base_orientation" else out


def check_joints(record: Record, ranges: Mapping[str, tuple[float, float]]) -> None:
  """Check names and units of a record against the joints of a robot.

  Args:
    record: The record.
    ranges: Range of each joint [rad or m]; infinite without limits.

  Raises:
    FileError: Positions lie so far outside a joint's range that the unit must be wrong.
    UnknownNameError: A joint does not exist.
  """
  for joint in record.joints:
    low, high = ranges[check_name("joint", joint, ranges, record.source)]
    span = high - low
    if not record.has("position", joint):
      continue
    values = record.of("position", [joint])[:, 0]
    if values.min() < low - span or values.max() > high + span:
      reach = (
        f"positions of '{joint}' reach {values[np.abs(values).argmax()]:.3g}, its range is [{low:.3g}, {high:.3g}]"
      )
      raise FileError(f"{record.source}: {reach}; name the unit, such as 'position/{joint} [deg]'")
