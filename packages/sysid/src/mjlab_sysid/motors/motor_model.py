"""Parametric motor fitted to records, for comparison with a learned one: PD, delay, friction, torque-speed limits."""

import io
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from mujoco.minimize import Verbosity, least_squares

_DELAYS = range(7)
# Samples of small efforts are not affected by limits.
_SHARES = (1.0, 0.6, 0.3)
# Torque-speed lines, in units of the largest effort and speed.
_LINES = ((1.5, 2.0), (1.0, 1.5), (0.7, 1.2))
_POLISHED, _ITERATIONS = 4, 60


class MotorModel(NamedTuple):
  """Motor with effort clamp(kp (q*(t - delay) - q) - kd q', -+ bounds) - friction tanh(q' / friction_speed).

  The bounds are those of a DC motor, as in `DcMotorActuatorCfg`: min(saturation_effort (1 -+ q' / velocity_limit),
  effort_limit). A limit that no sample reaches is infinite.
  """

  stiffness: float
  """kp [N m/rad]."""
  damping: float
  """kd [N m s/rad]."""
  delay: float
  """Delay of the targets, in samples."""
  friction: float
  """Coulomb friction [N m]."""
  friction_speed: float
  """Speed at which friction is mostly there [rad/s]."""
  effort_limit: float
  """Largest effort [N m]."""
  saturation_effort: float
  """Effort at stall, from which it falls with speed [N m]."""
  velocity_limit: float
  """Speed at which the effort reaches zero [rad/s]."""

  def efforts(self, rows: np.ndarray) -> np.ndarray:
    """Return efforts (rows,) of a stretch of target, position, velocity, effort, (rows, 4)."""
    target, position, velocity = rows[:, 0], rows[:, 1], rows[:, 2]
    late = np.interp(np.arange(len(rows)) - self.delay, np.arange(len(rows)), target)
    wanted = self.stiffness * (late - position) - self.damping * velocity
    drop = 0.0 if np.isinf(self.velocity_limit) else velocity * self.saturation_effort / self.velocity_limit
    lower, upper = (
      np.clip(np.minimum(self.saturation_effort + sign * drop, self.effort_limit), 0.0, None) for sign in (1.0, -1.0)
    )
    return np.clip(wanted, -lower, upper) - self.friction * np.tanh(velocity / self.friction_speed)

  def residual(self, tables: Sequence[np.ndarray], first: int) -> np.ndarray:
    """Return errors of the efforts in stretches, from row `first` of each on."""
    return np.concatenate([(self.efforts(rows) - rows[:, 3])[first:] for rows in tables])

  def error(self, tables: Sequence[np.ndarray], first: int) -> float:
    """Return the root mean square of the residual."""
    return float(np.sqrt(np.square(self.residual(tables, first)).mean()))

  def without_unused_limits(self, tables: Sequence[np.ndarray]) -> "MotorModel":
    """Return the model with infinite limits where no sample reaches them."""
    model = self
    for names in (("effort_limit",), ("saturation_effort", "velocity_limit")):
      unlimited = dict.fromkeys(names, np.inf)
      free = self._replace(**unlimited)
      if all(np.allclose(free.efforts(rows), self.efforts(rows)) for rows in tables):
        model = model._replace(**unlimited)
    return model


def fit_motor_model(tables: Sequence[np.ndarray], first: int) -> MotorModel:
  """Return the model of stretches of target, position, velocity, effort, (rows, 4), from row `first` of each on."""
  effort, velocity = np.concatenate([rows[:, [3, 2]] for rows in tables]).T
  most, fastest = float(np.abs(effort).max()), max(1e-6, float(np.abs(velocity).max()))
  starts = [
    fit_pd(tables, first, delay=delay, most=share * most)._replace(
      friction=0.05 * most,
      friction_speed=0.05 * fastest,
      effort_limit=1.02 * most,
      saturation_effort=stall * most,
      velocity_limit=speed * fastest,
    )
    for delay, share, (stall, speed) in itertools.product(_DELAYS, _SHARES, _LINES)
  ]

  def error(model: MotorModel) -> float:
    return model.error(tables, first)

  found = [_polished(model, tables, first, most, fastest) for model in sorted(starts, key=error)[:_POLISHED]]
  return min(found, key=error).without_unused_limits(tables)


def fit_pd(tables: Sequence[np.ndarray], first: int, *, delay: int = 0, most: float = np.inf) -> MotorModel:
  """Return the PD controller with a delay of whole samples that best fits efforts up to `most` (least squares)."""
  begin = max(first, delay)
  stretches = [np.column_stack((rows[begin - delay : len(rows) - delay, 0], rows[begin:, 1:])) for rows in tables]
  target, position, velocity, effort = np.concatenate(stretches).T
  used = np.abs(effort) <= most
  inputs = np.stack((target - position, -velocity), 1)
  stiffness, damping = np.linalg.lstsq(inputs[used], effort[used], rcond=None)[0].tolist()
  return MotorModel(max(1e-3, stiffness), max(1e-4, damping), delay, 0.0, 1.0, np.inf, np.inf, np.inf)


def _polished(motor: MotorModel, tables: Sequence[np.ndarray], first: int, most: float, fastest: float) -> MotorModel:
  scale = np.array(
    [motor.stiffness, max(motor.damping, 0.01 * motor.stiffness), 1.0, most, fastest, most, most, fastest]
  )
  lower = np.array([0.1, 0.0, 0.0, 0.0, 1e-3, 0.2, 0.2, 0.3])
  upper = np.array([10.0, 10.0, _DELAYS[-1] + 1.0, 0.5, 0.3, 2.0, 20.0, 50.0])

  def residual(z: np.ndarray) -> np.ndarray:
    return np.stack([MotorModel(*(scale * column)).residual(tables, first) for column in z.T], 1) / most

  best, _ = least_squares(
    np.clip(np.array(motor) / scale, lower + 1e-6, upper - 1e-6),
    residual,
    bounds=[lower, upper],
    eps=1e-4,
    max_iter=_ITERATIONS,
    verbose=Verbosity.SILENT,
    output=io.StringIO(),
  )
  return MotorModel(*(scale * np.asarray(best).ravel()).tolist())
