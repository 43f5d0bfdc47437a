"""Fit of a robot's parameters to its records by Gauss-Newton over batched rollouts, and what the records can tell.

The residual of a window is the difference between a rollout from its measured state and what was measured, divided by
the noise. The state itself is measured with noise, so it is marginalised: with S the derivative of the residuals by the
state in units of its noise, their covariance is C = 1 + S S^T, and C^(-1/2) r is minimised. The solver is that of
`mujoco.sysid`, `mujoco.minimize.least_squares`, whose finite-difference columns are all rolled out at once.
"""

import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from mjlab_core.constraints import Limits, Positive, PositiveCount, check_fields
from mjlab_core.errors import MjlabError
from mjlab_dr import FIELDS
from mujoco.minimize import Verbosity, least_squares

from mjlab_sysid.identified import Identified, Score, Trace
from mjlab_sysid.parameters import FitTerm, Parameter, Range
from mjlab_sysid.records import Record
from mjlab_sysid.robot import Robot
from mjlab_sysid.windows import Windows, cut
from mjlab_sysid.worlds import Worlds

# Finite differences: of parameters in units of half their range, of positions [rad or m] and velocities [1/s of it].
_STEP, _POSITION_STEP, _VELOCITY_STEP = 1e-4, 1e-5, 1e-3
# Residual of a world that diverged, in units of noise.
_DIVERGED = 1e3
PRIOR = 1.0 / math.sqrt(3.0)
"""Standard deviation of a uniform prior within the bounds, in units of half their width."""


@dataclass(kw_only=True)
class IdentifyCfg:
  """Settings of a fit."""

  window: Positive = 0.3
  """Length of a window [s]: long enough for a parameter to act, short enough for contacts and drift not to."""
  solver: Literal["gauss-newton", "cma"] = "gauss-newton"
  """Solver; CMA-ES, from the extra `cma`, needs no gradient, for records full of contacts."""
  iterations: PositiveCount = 40
  """Largest number of iterations, or of generations, of a pass."""
  tell: Annotated[float, Limits(gt=0, le=1)] = 0.1
  """Standard deviation, in units of half the bounds' width, above which records cannot tell a parameter."""
  threads: Annotated[int, Limits(ge=0)] = 0
  """Threads of the rollouts; 0 for all cores."""
  seed: int = 0
  """Seed of CMA-ES."""

  def __post_init__(self) -> None:
    check_fields(self, "IdentifyCfg")


class Progress(NamedTuple):
  """Progress of a fit after an iteration."""

  stage: str
  """Present stage."""
  iteration: int
  """Iterations of the stage."""
  cost: float
  """Half the sum of squared residuals, in units of noise."""


def identify(
  robot: Robot,
  records: Sequence[Record],
  fit: Sequence[FitTerm],
  cfg: IdentifyCfg | None = None,
  *,
  held_out: Sequence[Record] = (),
  ranges: Mapping[str, Range] | None = None,
  on_iteration: Callable[[Progress], bool | None] | None = None,
) -> Identified:
  """Fit parameters to records; those that the records cannot tell are named and stay at their prior.

  Args:
    robot: The robot on its stand.
    records: Records to fit to.
    fit: Parameters to fit.
    cfg: Settings; None for the defaults.
    held_out: Records that are only scored.
    ranges: Operation and bounds by field, such as those of a task's randomisation, where a term gives none.
    on_iteration: Function called after every iteration; a true result ends the fit with what is found so far.

  Raises:
    MjlabError: A record or a parameter is wrong; the message names it.
  """
  if not fit:
    raise MjlabError("no parameter to fit is given")
  problem = Problem(robot, cut(robot, records, (cfg := cfg or IdentifyCfg()).window), fit, ranges or {}, cfg)
  tested = Problem(robot, cut(robot, held_out, cfg.window), fit, ranges or {}, cfg) if held_out else None
  fitting = _Fit(problem, cfg, on_iteration)
  free = np.ones(problem.count, dtype=bool)
  x = fitting.solve("fit", np.zeros(problem.count), free)
  told, reasons = problem.identifiable(x, cfg.tell)
  if not told.all() and told.any():
    x = fitting.solve("fit what the records tell", np.where(told, x, 0.0), told)
  elif not told.any():
    x = np.zeros(problem.count)
  jacobian, scale = problem.information(x)
  information = jacobian.T @ jacobian / scale
  covariance = np.diag(np.full(problem.count, PRIOR**2))
  covariance[np.ix_(told, told)] = np.linalg.inv(information[np.ix_(told, told)] + np.eye(int(told.sum())) / PRIOR**2)
  half = np.array([parameter.half for parameter in problem.parameters])
  traces = problem.traces(x)
  tested_traces = tested.traces(x) if tested else []
  scores = [_score(trace, False) for trace in traces] + [_score(trace, True) for trace in tested_traces]
  return Identified(
    parameters=tuple(problem.parameters),
    numbers=problem.numbers(x[:, None])[0],
    covariance=covariance * np.outer(half, half),
    told=told,
    reasons=tuple(reasons),
    singular_values=np.linalg.svd(jacobian / math.sqrt(scale), compute_uv=False),
    scores=tuple(scores),
    traces=(*traces, *tested_traces),
    period=problem.windows.timestep * problem.windows.substeps,
    sources=tuple(dict.fromkeys(record.source for record in records)),
    overlay=problem.overlay(x, told),
    stopped=fitting.stopped,
  )


class Problem:
  """Residuals of windows as a function of parameters."""

  def __init__(
    self, robot: Robot, windows: Windows, fit: Sequence[FitTerm], ranges: Mapping[str, Range], cfg: IdentifyCfg
  ) -> None:
    self.robot, self.windows, self._fit, self._ranges, self._cfg = robot, windows, fit, ranges, cfg
    self._made: dict[int, Worlds] = {}
    worlds, self.parameters = self._worlds(1)
    del worlds
    self.count = len(self.parameters)
    self._start = np.array([parameter.start for parameter in self.parameters])
    self._half = np.array([parameter.half for parameter in self.parameters])
    self.lower = (np.array([parameter.lo for parameter in self.parameters]) - self._start) / self._half
    self.upper = (np.array([parameter.hi for parameter in self.parameters]) - self._start) / self._half
    self._basis: np.ndarray | None = None
    self._shrink: np.ndarray | None = None

  def _worlds(self, columns: int) -> tuple[Worlds, list[Parameter]]:
    worlds = Worlds(self.robot, columns * self.windows.count, self._cfg.threads)
    parameters = worlds.bind(self._fit, self._ranges)
    self._made[columns] = worlds
    return worlds, parameters

  def numbers(self, x: np.ndarray) -> np.ndarray:
    """Return fitted numbers, (columns, parameters), of candidates in units of half bounds, (parameters, columns)."""
    return self._start + self._half * np.clip(x.T, self.lower, self.upper)

  def overlay(self, x: np.ndarray, told: np.ndarray) -> dict[str, Any]:
    """Return the physical values of told parameters at a candidate, as an overlay file holds them."""
    worlds = Worlds(self.robot, 1)
    worlds.bind(self._fit, self._ranges)
    worlds.write(self.numbers(np.where(told, x, 0.0)[:, None]))
    out: dict[str, Any] = {
      "timestep": self.windows.timestep,
      "model": {},
      "actuators": {},
      "delay": {},
      "encoder_bias": {},
    }
    for parameter, is_told in zip(self.parameters, told, strict=True):
      if not is_told:
        continue
      for element in parameter.elements:
        if parameter.field in ("delay", "encoder_bias"):
          out[parameter.field][element] = worlds.own(parameter.field, element)
        elif FIELDS[parameter.field].kind == "target":
          number = float(self.numbers(x[:, None])[0][self.parameters.index(parameter)])
          scaled = worlds.default_of(parameter.field, element) * number
          out["actuators"].setdefault(parameter.field, {})[element] = (
            scaled if parameter.operation == "scale" else number
          )
        else:
          for name, values in worlds.physical(parameter.field, element).items():
            out["model"].setdefault(name, {})[element] = values
    return out

  def predict(
    self, x: np.ndarray, position: np.ndarray | None = None, velocity: np.ndarray | None = None
  ) -> dict[str, np.ndarray]:
    """Return signals of candidates, (parameters, columns), as (columns, windows, rows, joints)."""
    columns, windows = x.shape[1], self.windows
    worlds = self._made[columns] if columns in self._made else self._worlds(columns)[0]
    worlds.write(np.repeat(self.numbers(x), windows.count, 0))
    position = np.tile(windows.position, (columns, 1)) if position is None else position
    velocity = np.tile(windows.velocity, (columns, 1)) if velocity is None else velocity
    signals = windows.roll(worlds, position, velocity)
    return {name: values.reshape(columns, windows.count, *values.shape[1:]) for name, values in signals.items()}

  def residuals(self, signals: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return residuals in units of noise, (columns, windows, numbers of a window)."""
    parts = []
    for name, measured in self.windows.measured.items():
      seen = ~np.isnan(measured).any((0, 1))
      part = ((signals[name] - measured) / self.windows.sigma[name])[..., seen]
      parts.append(part.reshape(*part.shape[:2], -1))
    return np.clip(np.nan_to_num(np.concatenate(parts, -1), nan=_DIVERGED), -_DIVERGED, _DIVERGED)

  def marginalise(self, x: np.ndarray) -> None:
    """Take the uncertainty of the windows' first states into account, linearised at a candidate, (parameters,)."""
    windows = self.windows
    moved = np.flatnonzero(windows.uncertain[0, 0] > 0.0)
    columns = 1 + 2 * len(moved)
    position, velocity = (np.tile(part, (columns, 1, 1)) for part in (windows.position, windows.velocity))
    for place, joint in enumerate(moved):
      position[1 + place, :, joint] += _POSITION_STEP
      velocity[1 + len(moved) + place, :, joint] += _VELOCITY_STEP
    flat = (-1, position.shape[2])
    found = self.residuals(
      self.predict(np.tile(x[:, None], (1, columns)), position.reshape(flat), velocity.reshape(flat))
    )
    steps = np.repeat([_POSITION_STEP, _VELOCITY_STEP], len(moved))
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

  def information(self, x: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the Jacobian of the whitened residuals at a candidate, and the variance of these."""
    inward = np.where(x > 0.5 * (self.lower + self.upper), -_STEP, _STEP)
    base = self.whitened(x[:, None])
    jacobian = (self.whitened(x[:, None] + np.diag(inward)) - base) / inward
    return jacobian, float(np.square(base).sum() / max(1, len(base) - self.count))

  def identifiable(self, x: np.ndarray, tell: float) -> tuple[np.ndarray, list[str]]:
    """Return the parameters that the records tell, bool (parameters,), and the reason for each that they do not."""
    jacobian, scale = self.information(x)
    information = jacobian.T @ jacobian / scale
    names = [parameter.name for parameter in self.parameters]
    told = np.ones(self.count, dtype=bool)
    reasons = [""] * self.count
    while told.any():
      kept = np.flatnonzero(told)
      # A direction without any information is not infinite, so that the worst can be named.
      covariance = np.linalg.inv(information[np.ix_(kept, kept)] + 1e-6 * np.eye(len(kept)))
      spread = np.sqrt(np.diag(covariance))
      if spread.max() <= tell:
        break
      # Of several that only act together, the one with the smallest effect goes first.
      tied = spread > 0.5 * spread.max()
      worst = int(np.argmin(np.where(tied, information[kept, kept], np.inf)))
      correlation = covariance[worst] / (spread[worst] * spread)
      correlation[worst] = 0.0
      partner = int(np.argmax(np.abs(correlation)))
      index = kept[worst]
      alone = 1.0 / math.sqrt(information[index, index] + 1e-12)
      if alone > tell:
        reasons[index] = "the records hardly depend on it"
      elif abs(correlation[partner]) > 0.8:
        reasons[index] = f"the records tell it only together with {names[kept[partner]]}"
      else:
        reasons[index] = "the records tell it only together with several others"
      told[index] = False
    return told, reasons

  def traces(self, x: np.ndarray) -> list[Trace]:
    """Return positions by record and joint, measured, before the fit and at a candidate, (parameters,)."""
    before, after = (self.predict(candidate[:, None])["position"][0] for candidate in (np.zeros(self.count), x))
    measured = self.windows.measured["position"]
    out = []
    for record in dict.fromkeys(self.windows.records):
      rows = [name == record for name in self.windows.records]
      for column, joint in enumerate(self.windows.joints):
        if not np.isnan(measured[rows][..., column]).all():
          flat = [part[rows][..., column].ravel() for part in (measured, before, after)]
          out.append(Trace(record=record, joint=joint, measured=flat[0], before=flat[1], after=flat[2]))
    return out


def _score(trace: Trace, is_held_out: bool) -> Score:
  before, after = (float(np.sqrt(np.nanmean(np.square(part - trace.measured)))) for part in (trace.before, trace.after))
  return Score(record=trace.record, joint=trace.joint, before=before, after=after, is_held_out=is_held_out)


class _Fit:
  """Passes of a solver, which the caller may end."""

  def __init__(
    self, problem: Problem, cfg: IdentifyCfg, on_iteration: Callable[[Progress], bool | None] | None
  ) -> None:
    self._problem, self._cfg, self._on_iteration = problem, cfg, on_iteration
    self.stopped = False
    self._best: np.ndarray | None = None

  def solve(self, stage: str, x: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return the best candidate that differs from `x` in the free parameters alone."""
    problem = self._problem
    x = np.clip(x, problem.lower, problem.upper)
    # States depend on parameters, so that their uncertainty is linearised again at what the first pass finds.
    for _ in range(2):
      if self.stopped:
        break
      problem.marginalise(x)
      x = x.copy()
      x[free] = self._pass(stage, x, free)
    return x

  def _pass(self, stage: str, x: np.ndarray, free: np.ndarray) -> np.ndarray:
    problem = self._problem
    self._best = x[free]

    def residual(z: np.ndarray) -> np.ndarray:
      full = np.repeat(x[:, None], z.shape[1], 1)
      full[free] = z
      return np.concatenate((problem.whitened(full), z / PRIOR))

    try:
      if self._cfg.solver == "cma":
        self._evolve(stage, residual, x[free], problem.lower[free], problem.upper[free])
      else:

        def report(trace: Sequence[Any]) -> None:
          self._report(stage, len(trace), float(trace[-1].objective), trace[-1].candidate[:, 0])

        best, _ = least_squares(
          x[free],
          residual,
          bounds=[problem.lower[free], problem.upper[free]],
          eps=_STEP,
          xtol=1e-4,
          gtol=1e-3,
          mu_min=1e-3,
          mu_factor=10.0,
          max_iter=self._cfg.iterations,
          verbose=Verbosity.SILENT,
          output=io.StringIO(),
          iter_callback=report,
        )
        self._best = best
    except StopIteration:
      self.stopped = True
    assert self._best is not None
    return self._best

  def _report(self, stage: str, iteration: int, cost: float, candidate: np.ndarray) -> None:
    self._best = candidate.copy()
    if self._on_iteration is not None and self._on_iteration(Progress(stage, iteration, cost)):
      raise StopIteration

  def _evolve(
    self, stage: str, residual: Callable[[np.ndarray], np.ndarray], x: np.ndarray, lower: np.ndarray, upper: np.ndarray
  ) -> None:
    try:
      import cma
    except ModuleNotFoundError as error:
      raise ModuleNotFoundError(
        "CMA-ES needs the library cma: install mjlab-sysid with its extra 'cma'", name="cma"
      ) from error
    options = {"bounds": [lower.tolist(), upper.tolist()], "seed": self._cfg.seed + 1, "verbose": -9}
    search = cma.CMAEvolutionStrategy(x.tolist(), 0.3, options | {"maxiter": self._cfg.iterations})
    while not search.stop():
      candidates = search.ask()
      costs = 0.5 * np.square(residual(np.array(candidates).T)).sum(0)
      search.tell(candidates, costs.tolist())
      self._report(stage, search.countiter, float(search.result.fbest), np.asarray(search.result.xbest))
