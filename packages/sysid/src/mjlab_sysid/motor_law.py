"""Parametric motor fitted to records, for comparison with a learned one: PD, delay, friction, torque-speed limits."""

import io
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from mujoco.minimize import Verbosity, least_squares

_DELAYS = tuple(map(float, range(7)))
# Samples of small efforts know nothing of limits.
_SHARES = (1.0, 0.6, 0.3)
# Torque-speed lines, in units of the largest effort and speed.
_LINES = ((1.5, 2.0), (1.0, 1.5), (0.7, 1.2))
_POLISHED, _ITERATIONS = 4, 60


class MotorLaw(NamedTuple):
  """Motor with effort clamp(kp (q*(t - delay) - q) - kd q', -+ bounds) - friction tanh(q' / friction_speed).

  The bounds are those of a DC motor, as in `DcMotorActuatorCfg`: min(saturation_effort (1 -+ q' / velocity_limit),
  effort_limit). A limit that no sample reaches is infinite.
  """

  stiffness: float
  """kp [N m/rad]."""
  damping: float
  """kd [N m s/rad]."""
  delay: float
  """Delay of the set-points, in samples."""
  friction: float
  """Coulomb friction [N m]."""
  friction_speed: float
  """Speed at which friction is mostly there [rad/s]."""
  effort_limit: float
  """Largest effort [N m]."""
  saturation_effort: float
  """Effort at stall, from which it falls with speed [N m]."""
  velocity_limit: float
  """Speed at which no effort is left [rad/s]."""

  def efforts(self, rows: np.ndarray) -> np.ndarray:
    """Return efforts (rows,) of a stretch of target, position, velocity, effort, (rows, 4)."""
    wanted, lower, upper = self._wanted(rows)
    return np.clip(wanted, lower, upper) - self.friction * np.tanh(rows[:, 2] / self.friction_speed)

  def _wanted(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    target, position, velocity = rows[:, 0], rows[:, 1], rows[:, 2]
    late = np.interp(np.arange(len(rows)) - self.delay, np.arange(len(rows)), target)
    wanted = self.stiffness * (late - position) - self.damping * velocity
    drop = 0.0 if np.isinf(self.velocity_limit) else velocity * self.saturation_effort / self.velocity_limit
    lower = -np.clip(np.minimum(self.saturation_effort + drop, self.effort_limit), 0.0, None)
    return wanted, lower, np.clip(np.minimum(self.saturation_effort - drop, self.effort_limit), 0.0, None)

  def without_unused_limits(self, tables: Sequence[np.ndarray]) -> "MotorLaw":
    """Return the law with infinite limits where no sample reaches them."""
    reached = {"effort_limit": False, "saturation_effort": False}
    for name in reached:
      free = self._replace(**{name: np.inf}, **({"velocity_limit": np.inf} if name == "saturation_effort" else {}))
      reached[name] = any(not np.allclose(free.efforts(rows), self.efforts(rows)) for rows in tables)
    law = self if reached["effort_limit"] else self._replace(effort_limit=np.inf)
    return law if reached["saturation_effort"] else law._replace(saturation_effort=np.inf, velocity_limit=np.inf)


def fit_motor_law(tables: Sequence[np.ndarray], first: int) -> MotorLaw:
  """Return the law of stretches of target, position, velocity, effort, (rows, 4), from row `first` of each on."""
  effort = np.concatenate([rows[:, 3] for rows in tables])
  most, fastest = float(np.abs(effort).max()), max(1e-6, *(float(np.abs(rows[:, 2]).max()) for rows in tables))
  starts = []
  for delay, share, (stall, speed) in itertools.product(_DELAYS, _SHARES, _LINES):
    kp, kd = _gains(tables, delay, first, share * most)
    law = MotorLaw(kp, kd, delay, 0.05 * most, 0.05 * fastest, 1.02 * most, stall * most, speed * fastest)
    starts.append((_cost(law, tables, first), law))
  starts.sort(key=lambda entry: entry[0])
  found = [_polished(law, tables, first, most, fastest) for _, law in starts[:_POLISHED]]
  return min(found, key=lambda law: _cost(law, tables, first)).without_unused_limits(tables)


def _gains(tables: Sequence[np.ndarray], delay: float, first: int, most: float) -> tuple[float, float]:
  inputs = []
  for rows in tables:
    begin = max(first, int(delay))
    late = rows[begin - int(delay) : len(rows) - int(delay), 0]
    inputs.append(np.stack((late - rows[begin:, 1], -rows[begin:, 2], rows[begin:, 3]), 1))
  table = np.concatenate(inputs)
  table = table[np.abs(table[:, 2]) <= most]
  kp, kd = np.linalg.lstsq(table[:, :2], table[:, 2], rcond=None)[0]
  return max(1e-3, float(kp)), max(1e-4, float(kd))


def _residual(law: MotorLaw, tables: Sequence[np.ndarray], first: int) -> np.ndarray:
  return np.concatenate([(law.efforts(rows) - rows[:, 3])[first:] for rows in tables])


def _cost(law: MotorLaw, tables: Sequence[np.ndarray], first: int) -> float:
  return float(np.square(_residual(law, tables, first)).mean())


def _polished(law: MotorLaw, tables: Sequence[np.ndarray], first: int, most: float, fastest: float) -> MotorLaw:
  scale = np.array([law.stiffness, max(law.damping, 0.01 * law.stiffness), 1.0, most, fastest, most, most, fastest])
  lower = np.array([0.1, 0.0, 0.0, 0.0, 1e-3, 0.2, 0.2, 0.3])
  upper = np.array([10.0, 10.0, _DELAYS[-1] + 1.0, 0.5, 0.3, 2.0, 20.0, 50.0])

  def residual(z: np.ndarray) -> np.ndarray:
    return np.stack([_residual(MotorLaw(*(scale * column)), tables, first) for column in z.T], 1) / most

  best, _ = least_squares(
    np.clip(np.array(law) / scale, lower + 1e-6, upper - 1e-6),
    residual,
    bounds=[lower, upper],
    eps=1e-4,
    max_iter=_ITERATIONS,
    verbose=Verbosity.SILENT,
    output=io.StringIO(),
  )
  return MotorLaw(*(scale * np.asarray(best).ravel()).tolist())
