"""Records cut into windows: each is a rollout of its own from a measured state, so that errors do not pile up."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mjlab_core.errors import MjlabError

from mjlab_sysid.records import JOINT_SIGNALS, Record, check_joints, uniform
from mjlab_sysid.robot import Robot
from mjlab_sysid.worlds import Worlds

MEASURED = ("position", "velocity", "effort")
"""Signals that are compared."""
_TARGETS = tuple(name for name in JOINT_SIGNALS if name.endswith("_target"))
_LONGEST_DELAY = 0.25


@dataclass(frozen=True, kw_only=True)
class Windows:
  """Windows of equal length, and what the robot was told and did in them."""

  joints: tuple[str, ...]
  """All joints of the robot, in the order of columns."""
  records: tuple[str, ...]
  """Record of each window, (windows,)."""
  timestep: float
  """Timestep of the simulation [s]."""
  substeps: int
  """Timesteps from a row to the next."""
  position: np.ndarray
  """Readings at the beginning, (windows, joints) [rad or m]."""
  velocity: np.ndarray
  """Velocities at the beginning, (windows, joints) [rad/s or m/s]."""
  uncertain: np.ndarray
  """Standard deviations of both, (windows, 2, joints); 0 for joints that no record moves."""
  measured: dict[str, np.ndarray]
  """Signals after the beginning, (windows, rows, joints); NaN where there is none."""
  sigma: dict[str, np.ndarray]
  """Noise of each signal, (joints,)."""
  commands: dict[str, np.ndarray]
  """Set-points of all records, one after the other, (rows, joints)."""
  first: np.ndarray
  """Row of `commands` at the beginning of each window, (windows,)."""

  @property
  def count(self) -> int:
    """Number of windows."""
    return len(self.first)

  @property
  def rows(self) -> int:
    """Rows of a window after its beginning."""
    return next(iter(self.measured.values())).shape[1]

  def roll(self, worlds: Worlds, position: np.ndarray, velocity: np.ndarray) -> dict[str, np.ndarray]:
    """Return the signals in worlds that begin in these states, (num_worlds, rows, joints); NaN where one diverged.

    Args:
      worlds: As many as windows, or a multiple: window by window, again and again.
      position: Readings at the beginning, (num_worlds, joints).
      velocity: Velocities at the beginning, (num_worlds, joints).
    """
    out = {name: np.empty((worlds.num_envs, self.rows, len(self.joints))) for name in self.measured}
    first = np.tile(self.first, worlds.num_envs // self.count)
    sums = {name: np.cumsum(np.pad(values, ((1, 0), (0, 0))), 0) for name, values in self.commands.items()}
    worlds.begin(position, velocity)
    last = self.rows * self.substeps + 1
    for step in range(last + 1):
      for name, late in (("position", 0), ("velocity", 0), ("effort", 1)):
        # Efforts are those of the timestep before.
        row, rest = divmod(step - late, self.substeps)
        if name in out and rest == 0 and 1 <= row <= self.rows:
          out[name][:, row - 1] = worlds.read(name)
      if step < last:
        begin = first[:, None] + (step * self.timestep - worlds.delay) / (self.substeps * self.timestep)
        worlds.step({name: _mean(sums[name], self.commands[name], begin, 1.0 / self.substeps) for name in _TARGETS})
    return out


def _mean(integral: np.ndarray, values: np.ndarray, begin: np.ndarray, length: float) -> np.ndarray:
  """Return the mean of held values from row `begin` on, (n, columns), over a length [rows]."""
  columns = np.arange(values.shape[1])

  def until(at: np.ndarray) -> np.ndarray:
    whole = np.clip(np.floor(at + 1e-9).astype(int), 0, len(values) - 1)
    return integral[whole, columns] + (at - whole) * values[whole, columns]

  return (until(begin + length) - until(begin)) / length


def cut(robot: Robot, records: Sequence[Record], window: float) -> Windows:
  """Return the windows of some records.

  Args:
    robot: The robot that was recorded.
    records: At least positions and one command of every joint that they name.
    window: Length of a window [s].

  Raises:
    FileError: A joint does not exist, lacks a signal, or its unit must be wrong.
    MjlabError: Records are shorter than a window.
  """
  timestep, joints = float(robot.model.opt.timestep), robot.joints
  if not records:
    raise MjlabError("no record is given")
  periods = [record.period for record in records]
  substeps = max(1, round(float(np.median(periods)) / timestep))
  period = substeps * timestep
  rows = max(2, round(window / period))
  addresses, _ = robot.addresses(joints)
  pose = robot.pose[addresses]
  pad = round(_LONGEST_DELAY / period)
  tables: dict[str, list[np.ndarray]] = {name: [] for name in (*_TARGETS, *MEASURED)}
  first: list[int] = []
  names: list[str] = []
  offset = 0
  for record in records:
    check_joints(record, robot.ranges())
    _check_signals(record)
    for part in uniform(record, period):
      full = {name: _spread(part, name, joints) for name in (*_TARGETS, *MEASURED)}
      position = full["position"]
      target = full["position_target"]
      # A joint that is not commanded stays where it is told to, or where it was.
      unmoved = np.isnan(target).all(0)
      target[:, unmoved] = np.where(np.isnan(position[0, unmoved]), pose[unmoved], position[0, unmoved])
      for name in _TARGETS[1:]:
        full[name] = np.nan_to_num(full[name])
      begins = range(0, part.num_rows - rows, rows)
      first += [offset + pad + begin for begin in begins]
      names += [record.source] * len(begins)
      for name, values in full.items():
        tables[name].append(np.concatenate((np.repeat(values[:1], pad, 0), values)))
      offset += pad + part.num_rows
  if not first:
    longest = max(record.time[-1] - record.time[0] for record in records)
    raise MjlabError(f"windows of {window:g} s are longer than the records, of at most {longest:.3g} s")
  whole = {name: np.concatenate(parts) for name, parts in tables.items()}
  starts = np.array(first)
  after = starts[:, None] + np.arange(1, rows + 1)
  seen = {name: whole[name] for name in MEASURED if not np.isnan(whole[name]).all()}
  sigma = {name: _noise(values) for name, values in seen.items()}
  position, velocity, uncertain = _beginnings(seen, sigma, starts, period)
  position = np.where(np.isnan(position), pose, position)
  return Windows(
    joints=joints,
    records=tuple(names),
    timestep=timestep,
    substeps=substeps,
    position=position,
    velocity=velocity,
    uncertain=uncertain,
    measured={name: values[after] for name, values in seen.items()},
    sigma=sigma,
    commands={name: whole[name] for name in _TARGETS},
    first=starts,
  )


def _spread(record: Record, name: str, joints: Sequence[str]) -> np.ndarray:
  out = np.full((record.num_rows, len(joints)), np.nan)
  if name in record.signals:
    out[:, [joints.index(joint) for joint in record.joints]] = record.signals[name]
  return out


def _check_signals(record: Record) -> None:
  moved = [joint for joint in record.joints if any(record.has(name, joint) for name in _TARGETS)]
  if not moved:
    raise MjlabError(f"{record.source}: no joint has a command: 'position_target/JOINT' and so on")
  record.of("position", moved)


def _noise(values: np.ndarray) -> np.ndarray:
  """Return the noise of signals by joint, (joints,): of their third differences, and of their quantisation."""
  out = np.ones(values.shape[1])
  for column, series in enumerate(values.T):
    series = series[~np.isnan(series)]
    if len(series) < 8:
      continue
    third = float(np.median(np.abs(np.diff(series, 3)))) / 0.6745 / np.sqrt(20.0)
    steps = np.abs(np.diff(series))
    smallest = float(steps[steps > 0.0].min()) if np.any(steps > 0.0) else 0.0
    is_coarse = np.mean(steps == 0.0) > 0.2
    out[column] = max(third, smallest / np.sqrt(12.0) if is_coarse else 0.0, 1e-5 * float(np.ptp(series)), 1e-9)
  return out


def _beginnings(
  seen: dict[str, np.ndarray], sigma: dict[str, np.ndarray], starts: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
  """Return readings and velocities at the beginnings of windows, and how uncertain they are."""
  position = seen["position"]
  noise = np.broadcast_to(sigma["position"], position[starts].shape)
  slope = np.gradient(position, period, axis=0)[starts]
  bend = np.gradient(np.gradient(position, period, axis=0), period, axis=0)
  roughness = np.sqrt(np.nanmean(np.square(np.nan_to_num(bend)), 0)) * period
  spread = np.sqrt(0.5 * np.square(noise / period) + np.square(0.25 * roughness))
  velocity = slope
  if "velocity" in seen:
    measured = seen["velocity"][starts]
    velocity = np.where(np.isnan(measured), slope, measured)
    spread = np.where(np.isnan(measured), spread, sigma["velocity"])
  absent = np.isnan(position[starts])
  uncertain = np.where(absent[:, None], 0.0, np.stack((noise, spread), 1))
  return position[starts], np.where(absent, 0.0, velocity), uncertain
