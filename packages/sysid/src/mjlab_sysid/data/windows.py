"""Records cut into windows: each is a separate rollout from a measured state, so that errors do not grow."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from mjlab_core.errors import MjlabError
from mjlab_core.rotations import quat_apply_inverse, quat_box_minus

from mjlab_sysid.data.records import BODY_SIGNALS, Record, arranged, check_joints, elements, uniform
from mjlab_sysid.robot import IMU, Robot
from mjlab_sysid.worlds import TARGETS, Commands, Worlds

JOINTS = ("position", "velocity", "effort")
"""Signals of joints that are compared."""
BASE = ("base_position", "base_orientation")
"""Signals of a base that moves."""
_LONGEST_DELAY = 0.25


@dataclass(frozen=True, kw_only=True)
class Windows:
  """Windows of equal length, with commands and measurements."""

  joints: tuple[str, ...]
  """All joints of the robot, in the order of columns."""
  records: tuple[str, ...]
  """Record of each window, (windows,)."""
  timestep: float
  """Timestep of the simulation [s]."""
  substeps: int
  """Timesteps from a row to the next."""
  state: np.ndarray
  """Readings of positions and velocities at the beginning, (windows, 2, columns), as in `Worlds.begin`."""
  orientation: np.ndarray | None
  """Orientations at the beginning of a base that moves, (windows, 4)."""
  uncertain: np.ndarray
  """Standard deviations of `state`, (windows, 2, columns); 0 for joints that no record moves."""
  measured: dict[str, np.ndarray]
  """Signals after the beginning, (windows, rows, joints, 3 or 4); NaN where there is none."""
  sigma: dict[str, np.ndarray]
  """Noise of each signal, (joints or 3,)."""
  commands: dict[str, np.ndarray]
  """Targets of all records, one after the other, (rows, joints)."""
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

  def roll(self, worlds: Worlds, state: np.ndarray) -> dict[str, np.ndarray]:
    """Return the signals in worlds that begin in these states, (num_worlds, rows, ...); NaN where one diverged.

    Args:
      worlds: One world for each window, or several such sets one after the other.
      state: Readings of positions and velocities at the beginning, (num_worlds, 2, columns).
    """
    copies, device = worlds.num_envs // self.count, worlds.sim.device
    if worlds.commands is None or worlds.commands.source is not self:
      first = np.tile(self.first, copies)
      worlds.obey(Commands(self, self.commands, first, self.timestep, self.substeps, device))
    out = {
      name: torch.empty(worlds.num_envs, self.rows, values.shape[2], dtype=torch.float64, device=device)
      for name, values in self.measured.items()
    }
    worlds.begin(state, None if self.orientation is None else np.tile(self.orientation, (copies, 1)))
    last = self.rows * self.substeps + 1
    for step in range(last + 1):
      for name, values in out.items():
        row, rest = divmod(step - worlds.is_late(name), self.substeps)
        if rest == 0 and 1 <= row <= self.rows:
          values[:, row - 1] = worlds.read(name)
      if step < last:
        worlds.follow()
    return {name: values.cpu().numpy() for name, values in out.items()}


def difference(name: str, predicted: np.ndarray, measured: np.ndarray) -> np.ndarray:
  """Return predicted minus measured values of a signal; of orientations, a rotation vector in the world, (..., 3)."""
  if name != "base_orientation":
    return predicted - measured
  one, other = np.broadcast_arrays(predicted, measured)
  return quat_box_minus(*(torch.from_numpy(np.array(x)) for x in (one, other))).numpy()


def cut(robot: Robot, records: Sequence[Record], window: float) -> Windows:
  """Return the windows of records.

  Args:
    robot: The robot that was recorded.
    records: At least positions and one command of every joint that they name.
    window: Length of a window [s].

  Raises:
    FileError: A joint lacks a signal, or has a wrong unit.
    UnknownNameError: A joint does not exist.
    MjlabError: Records are shorter than a window.
  """
  timestep = float(robot.model.opt.timestep)
  substeps = max(1, round(float(np.median([record.period for record in records])) / timestep))
  period = substeps * timestep
  rows = max(2, round(window / period))
  body = _body_signals(robot, records)
  whole, names, starts = _joined(robot, records, body, period, rows)
  if not len(starts):
    longest = max(record.time[-1] - record.time[0] for record in records)
    raise MjlabError(f"windows of {window:g} s are longer than the records, of at most {longest:.3g} s")
  seen = {name: whole[name] for name in (*JOINTS, *body) if not np.isnan(whole[name]).all()}
  series = seen | ({"base_orientation": _turns(seen["base_orientation"])} if robot.base else {})
  sigma = {name: _noise(values) for name, values in series.items()}

  def beginnings(name: str) -> np.ndarray:
    return _beginnings(series, sigma, name, starts, period, timestep)

  state, uncertain = beginnings("position")
  state[:, 0] = np.where(np.isnan(state[:, 0]), _pose(robot), state[:, 0])
  orientation = None
  if robot.base:
    orientation = seen["base_orientation"][starts]
    turn, turn_noise = beginnings("base_orientation")
    turn[:, 0] = 0.0
    # MuJoCo has the angular velocity of a free joint in the frame of its body.
    turn[:, 1] = quat_apply_inverse(torch.from_numpy(orientation), torch.from_numpy(turn[:, 1])).numpy()
    place, place_noise = beginnings("base_position")
    state = np.concatenate((state, place, turn), 2)
    uncertain = np.concatenate((uncertain, place_noise, turn_noise), 2)
  after = starts[:, None] + np.arange(1, rows + 1)
  return Windows(
    joints=robot.joints,
    records=names,
    timestep=timestep,
    substeps=substeps,
    state=state,
    orientation=orientation,
    uncertain=uncertain,
    measured={name: values[after] for name, values in seen.items()},
    sigma=sigma,
    commands={name: whole[name] for name in TARGETS},
    first=starts,
  )


def _joined(
  robot: Robot, records: Sequence[Record], body: Sequence[str], period: float, rows: int
) -> tuple[dict[str, np.ndarray], tuple[str, ...], np.ndarray]:
  """Return the signals of all records, one after the other, and the record and first row of each window."""
  tables: dict[str, list[np.ndarray]] = {name: [] for name in (*TARGETS, *JOINTS, *body)}
  pad, offset = round(_LONGEST_DELAY / period), 0
  names: list[str] = []
  first: list[int] = []
  for record in records:
    check_joints(record, robot.ranges())
    _check_signals(record)
    for part in uniform(record, period):
      full = {name: _columns(part, name, robot.joints) for name in tables}
      # A joint without commands holds its first measured position, or its pose.
      target, measured = full["position_target"], full["position"][0]
      unmoved = np.isnan(target).all(0)
      target[:, unmoved] = np.where(np.isnan(measured), _pose(robot), measured)[unmoved]
      for name in TARGETS[1:]:
        full[name] = np.nan_to_num(full[name])
      # Velocities need rows before.
      begins = range(2, part.num_rows - rows, rows) or range(0, part.num_rows - rows, rows)
      first += [offset + pad + begin for begin in begins]
      names += [record.source] * len(begins)
      for name, values in full.items():
        tables[name].append(np.concatenate((np.repeat(values[:1], pad, 0), values)))
      offset += pad + part.num_rows
  whole = {name: np.concatenate(parts) for name, parts in tables.items() if parts}
  return whole, tuple(names), np.array(first, dtype=np.int64)


def _pose(robot: Robot) -> np.ndarray:
  return robot.pose[robot.addresses(robot.joints)[0]]


def _body_signals(robot: Robot, records: Sequence[Record]) -> tuple[str, ...]:
  """Return the signals of the IMU and the base that are compared; warn of the others."""
  for record in records:
    if robot.base and not all(name in record.signals for name in BASE):
      raise MjlabError(f"{record.source}: the base moves, so the record needs {' and '.join(BASE)}")
    others = [name for name in BODY_SIGNALS if name in record.signals and not _has(robot, name)]
    if others:
      why = "the robot's base is held" if others[0] in BASE else "the model has no IMU on a body that moves"
      warnings.warn(f"{record.source}: {', '.join(others)} not compared: {why}", stacklevel=3)
  return tuple(name for name in BODY_SIGNALS if _has(robot, name))


def _has(robot: Robot, name: str) -> bool:
  return robot.has_imu if name in IMU else robot.base is not None


def _turns(orientation: np.ndarray) -> np.ndarray:
  """Return sums of the small rotations from row to row, (rows, 3); their slopes are angular velocities in the world."""
  steps = difference("base_orientation", orientation[1:], orientation[:-1])
  return np.concatenate((np.zeros((1, 3)), np.cumsum(steps, 0)))


def _columns(record: Record, name: str, joints: Sequence[str]) -> np.ndarray:
  """Return a signal of a record with the columns of all joints; NaN where the record lacks it."""
  values = record.signals.get(name)
  if values is None:
    return np.full((record.num_rows, len(elements(name, joints))), np.nan)
  return values if name in BODY_SIGNALS else arranged(values, record.joints, joints)


def _check_signals(record: Record) -> None:
  moved = [joint for joint in record.joints if any(record.has(name, joint) for name in TARGETS)]
  if not moved:
    raise MjlabError(f"{record.source}: no joint has a command: 'position_target/JOINT' and so on")
  record.of("position", moved)


def _noise(values: np.ndarray) -> np.ndarray:
  """Return the noise of signals by joint, (joints,), from their third differences and their quantisation."""
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
  seen: dict[str, np.ndarray],
  sigma: dict[str, np.ndarray],
  name: str,
  starts: np.ndarray,
  period: float,
  timestep: float,
) -> np.ndarray:
  """Return readings of a signal and velocities at the beginnings of windows, and their standard deviations.

  The result is (2, windows, 2, columns).
  """
  position = seen[name]
  noise = np.broadcast_to(sigma[name], position[starts].shape)
  rough = np.gradient(position, period, axis=0)
  slope = rough.copy()
  # The fourth order; its error is a part of the second order's.
  slope[2:-2] = (8.0 * (position[3:-1] - position[1:-3]) - (position[4:] - position[:-4])) / (12.0 * period)
  error = 0.5 * np.sqrt(np.nanmean(np.square(np.nan_to_num(slope - rough)), 0))
  # In implicit Euler a position changes by the velocity after the step: velocities belong half a timestep earlier.
  slope = (slope - 0.5 * timestep * np.gradient(slope, period, axis=0))[starts]
  std = np.sqrt(np.square(0.95 * noise / period) + np.square(error))
  velocity = slope
  if name == "position" and "velocity" in seen:
    measured = seen["velocity"][starts]
    velocity = np.where(np.isnan(measured), slope, measured)
    std = np.where(np.isnan(measured), std, sigma["velocity"])
  absent = np.isnan(position[starts])
  state = np.stack((position[starts], np.where(absent, 0.0, velocity)), 1)
  return np.stack((state, np.where(absent[:, None], 0.0, np.stack((noise, std), 1))))
