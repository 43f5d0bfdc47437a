"""Residuals of a fit as a function of its parameters, and the information of records about these.

The residual of a window is the difference between a rollout from its measured state and the measurements, divided by
the noise. The state itself is measured with noise, so it is marginalised: with S the derivative of the residuals by the
state in units of its noise, their covariance is C = 1 + S S^T, and C^(-1/2) r is minimised.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import torch
from mjlab_core.constraints import Limits, Positive, PositiveCount, check_fields

from mjlab_sysid.data.records import BODY_SIGNALS, UNITS, elements
from mjlab_sysid.data.windows import Windows, difference
from mjlab_sysid.engines import EngineName
from mjlab_sysid.identified import Information, Trace
from mjlab_sysid.parameters import FitTerm, Range
from mjlab_sysid.progress import fingerprint
from mjlab_sysid.robot import Robot
from mjlab_sysid.worlds import Worlds


class _Steps(NamedTuple):
  """Finite differences, as small as the precision of an engine allows."""

  parameter: float
  """In units of half the bounds."""
  position: float
  """[rad or m]."""
  velocity: float
  """[rad/s or m/s]."""


_STEPS = {torch.float64: _Steps(1e-4, 1e-5, 1e-3), torch.float32: _Steps(1e-2, 1e-3, 1e-2)}
# Residual of a world that diverged, in units of noise.
_DIVERGED = 1e3
# Units of traces that are not of joints.
_UNITS = {name: next(iter(UNITS[quantity])) for name, quantity in BODY_SIGNALS.items()} | {
  "angular_velocity": "rad/s",
  "base_orientation": "rad",
}
# Length of a column of the Jacobian without effect, and values that are tried instead.
_FLAT, _TRIED = 1e-3, 10
PRIOR = 1.0 / math.sqrt(3.0)
"""Standard deviation of a uniform prior within the bounds, in units of half their width."""


@dataclass(kw_only=True)
class IdentifyCfg:
  """Settings of a fit."""

  window: Positive = 0.3
  """Length of a window [s]: long enough for parameters to act, short enough to limit contacts and drift."""
  solver: Literal["gauss-newton", "cma"] = "gauss-newton"
  """Solver; CMA-ES, from the extra `cma`, needs no gradient, for records full of contacts."""
  iterations: PositiveCount = 40
  """Largest number of iterations, or of generations, of a pass."""
  max_std: Annotated[float, Limits(gt=0, le=1)] = 0.1
  """Largest standard deviation of an identifiable parameter, in units of half the bounds' width."""
  engine: EngineName = "auto"
  """`native`: MuJoCo's own batch, on a CPU. `warp`: MuJoCo Warp, from the extra `warp`. `auto`: Warp on a GPU."""
  device: str = "cpu"
  """Device of the rollouts: cpu or cuda:0."""
  threads: Annotated[int, Limits(ge=0)] = 0
  """Threads of the rollouts on a CPU; 0 for all cores."""
  seed: int = 0
  """Seed of CMA-ES."""

  def __post_init__(self) -> None:
    check_fields(self, "IdentifyCfg")


class Problem:
  """Residuals of windows as a function of parameters."""

  def __init__(
    self, robot: Robot, windows: Windows, fit: Sequence[FitTerm], ranges: Mapping[str, Range], cfg: IdentifyCfg
  ) -> None:
    self.robot, self.windows, self._fit, self._ranges, self._cfg = robot, windows, fit, ranges, cfg
    self._made: dict[int, Worlds] = {}
    worlds = self._worlds(1)
    self.parameters, self.steps = worlds.parameters, _STEPS[worlds.sim.dtype]
    self.count = len(self.parameters)
    self._start, lo, hi = np.array([(parameter.start, parameter.lo, parameter.hi) for parameter in self.parameters]).T
    self._half = 0.5 * (hi - lo)
    self.lower, self.upper = (lo - self._start) / self._half, (hi - self._start) / self._half
    self._basis: np.ndarray | None = None
    self._shrink: np.ndarray | None = None

  def _worlds(self, columns: int) -> Worlds:
    """Return the worlds of `columns` candidates."""
    if columns not in self._made:
      cfg, count = self._cfg, columns * self.windows.count
      worlds = Worlds(self.robot, count, engine=cfg.engine, device=cfg.device, threads=cfg.threads)
      worlds.bind(self._fit, self._ranges)
      self._made[columns] = worlds
    return self._made[columns]

  @property
  def key(self) -> str:
    """Digest of the records, the parameters and the settings."""
    windows, cfg = self.windows, self._cfg
    arrays = (*windows.measured.values(), *windows.commands.values(), windows.first)
    return fingerprint(self.parameters, cfg.window, cfg.solver, cfg.max_std, *arrays)

  def numbers(self, x: np.ndarray) -> np.ndarray:
    """Return fitted numbers, (columns, parameters), of candidates in units of half bounds, (parameters, columns)."""
    return self._start + self._half * np.clip(x.T, self.lower, self.upper)

  def overlay(self, x: np.ndarray, identifiable: np.ndarray) -> dict[str, Any]:
    """Return the physical values of identifiable parameters at a candidate, as an overlay file holds them."""
    worlds = Worlds(self.robot, 1)
    worlds.bind(self._fit, self._ranges)
    numbers = self.numbers(np.where(identifiable, x, 0.0)[:, None])[0]
    return {"timestep": self.windows.timestep, **worlds.overlay(numbers, identifiable)}

  def predict(self, x: np.ndarray, states: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Return signals of candidates as (columns, windows, rows, joints).

    Args:
      x: The candidates, (parameters, columns).
      states: First states, (columns, windows, 2, joints); None for those of the windows.
    """
    columns, windows = x.shape[1], self.windows
    worlds = self._worlds(columns)
    worlds.write(np.repeat(self.numbers(x), windows.count, 0))
    states = np.stack([windows.state] * columns) if states is None else states
    signals = windows.roll(worlds, np.concatenate(states))
    return {name: values.reshape(columns, windows.count, *values.shape[1:]) for name, values in signals.items()}

  def residuals(self, signals: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return residuals in units of noise, (columns, windows, numbers of a window)."""
    parts = []
    for name, measured in self.windows.measured.items():
      away = difference(name, signals[name], measured)
      seen = ~np.isnan(measured[..., : away.shape[-1]]).any((0, 1))
      part = (away / self.windows.sigma[name])[..., seen]
      parts.append(part.reshape(*part.shape[:2], -1))
    return np.clip(np.nan_to_num(np.concatenate(parts, -1), nan=_DIVERGED), -_DIVERGED, _DIVERGED)

  def marginalise(self, x: np.ndarray) -> None:
    """Take the uncertainty of the windows' first states into account, linearised at a candidate, (parameters,)."""
    windows = self.windows
    moved = np.flatnonzero(windows.uncertain[0, 0] > 0.0)
    kind, column, steps = np.repeat([0, 1], len(moved)), np.tile(moved, 2), np.repeat(self.steps[1:], len(moved))
    states = np.stack([windows.state] * (1 + len(steps)))
    states[1 + np.arange(len(steps)), :, kind, column] += steps[:, None]
    found = self.residuals(self.predict(np.stack([x] * len(states), 1), states))
    slopes = (found[1:] - found[:1]) / steps[:, None, None]
    noise = windows.uncertain[:, :, moved].reshape(windows.count, -1)
    basis, singular, _ = np.linalg.svd(slopes.transpose(1, 2, 0) * noise[:, None], full_matrices=False)
    self._basis, self._shrink = basis, 1.0 - 1.0 / np.sqrt(1.0 + singular**2)

  def whitened(self, x: np.ndarray) -> np.ndarray:
    """Return residuals of candidates, (parameters, columns), as (numbers, columns)."""
    found = self.residuals(self.predict(x))
    if self._basis is not None and self._shrink is not None:
      inside = np.einsum("wdk,cwd->cwk", self._basis, found)
      found = found - np.einsum("wdk,cwk->cwd", self._basis, self._shrink * inside)
    return found.reshape(x.shape[1], -1).T

  def jacobian(self, x: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the Jacobian of the whitened residuals at a candidate, and the variance of these."""
    inward = np.where(x > 0.5 * (self.lower + self.upper), -self.steps.parameter, self.steps.parameter)
    base = self.whitened(x[:, None])
    jacobian = (self.whitened(x[:, None] + np.diag(inward)) - base) / inward
    return jacobian, float(np.square(base).sum() / max(1, len(base) - self.count))

  def information(self, jacobian: np.ndarray, identifiable: np.ndarray) -> Information:
    """Return the information of a Jacobian in units of noise.

    Args:
      jacobian: The Jacobian, (residuals, parameters).
      identifiable: True for the parameters that are fitted, bool (parameters,); the others keep their prior.
    """
    fitted = jacobian[:, identifiable]
    precision = fitted.T @ fitted + np.eye(fitted.shape[1]) / PRIOR**2
    covariance = PRIOR**2 * np.eye(self.count)
    covariance[np.ix_(identifiable, identifiable)] = np.linalg.inv(precision)
    return Information(np.linalg.svd(jacobian, compute_uv=False), covariance * np.outer(self._half, self._half))

  def off_plateaus(self, x: np.ndarray) -> np.ndarray:
    """Return a candidate, (parameters,), with the best of some values for each parameter without a derivative.

    A limit that is not reached is such a parameter.
    """
    x, slopes = x.copy(), np.linalg.norm(self.jacobian(x)[0], axis=0)
    for place in np.flatnonzero(slopes < _FLAT):
      tried = np.repeat(x[:, None], _TRIED, 1)
      tried[place, 1:] = np.linspace(self.lower[place], self.upper[place], _TRIED + 1)[1:-1]
      x[place] = tried[place, np.square(self.whitened(tried)).sum(0).argmin()]
    return x

  def reasons(self, x: np.ndarray) -> list[str]:
    """Return the reason for each parameter that the records do not identify, and "" for the others."""
    jacobian, variance = self.jacobian(x)
    information = jacobian.T @ jacobian / variance
    kept = np.arange(self.count)
    reasons = [""] * self.count
    while len(kept):
      # A direction without any information is not infinite, so that the worst can be named.
      covariance = np.linalg.inv(information[np.ix_(kept, kept)] + 1e-6 * np.eye(len(kept)))
      std = np.sqrt(np.diag(covariance))
      if std.max() <= self._cfg.max_std:
        break
      # Of several that only act together, the one with the smallest effect goes first.
      tied = std > 0.5 * std.max()
      worst = int(np.argmin(np.where(tied, information[kept, kept], np.inf)))
      correlation = np.abs(covariance[worst] / (std[worst] * std))
      correlation[worst] = 0.0
      partner = int(np.argmax(correlation))
      index = kept[worst]
      alone = 1.0 / math.sqrt(information[index, index] + 1e-12)
      if alone > self._cfg.max_std:
        reasons[index] = "the records hardly depend on it"
      elif correlation[partner] > 0.8:
        reasons[index] = f"the records identify it only together with {self.parameters[kept[partner]].name}"
      else:
        reasons[index] = "the records identify it only together with several others"
      kept = np.delete(kept, worst)
    return reasons

  def traces(self, x: np.ndarray, *, is_held_out: bool) -> list[Trace]:
    """Return positions by record and joint, measured, before the fit and at a candidate, (parameters,)."""
    before, after = (self.predict(candidate[:, None]) for candidate in (np.zeros(self.count), x))
    out = []
    for record in dict.fromkeys(self.windows.records):
      rows = [name == record for name in self.windows.records]
      for signal, shown in self._shown(before, after).items():
        for column, element in enumerate(elements(signal, self.windows.joints)[-shown[0].shape[2] :]):
          measured, initial, fitted = (part[rows][..., column].ravel() for part in shown)
          if not np.isnan(measured).all():
            joint = element if signal == "position" else f"{signal}/{element} [{_UNITS[signal]}]"
            out.append(Trace(record, joint, measured, initial, fitted, is_held_out))
    return out

  def _shown(self, *predicted: Mapping[str, np.ndarray]) -> dict[str, list[np.ndarray]]:
    """Return measured and predicted signals of traces; orientations as rotation vectors from the measured ones."""
    out = {}
    for name, measured in self.windows.measured.items():
      if name == "position" or name in BODY_SIGNALS:
        away = [difference(name, signals[name][0], measured) for signals in predicted]
        origin = np.zeros_like(away[0]) if name == "base_orientation" else measured
        out[name] = [origin, *(origin + part for part in away)]
    return out
