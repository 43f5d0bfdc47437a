"""Fit of a robot's parameters to its records by Gauss-Newton over batched rollouts.

The solver is that of `mujoco.sysid`, `mujoco.minimize.least_squares`, whose finite-difference columns are all rolled
out at once; `problem` has the residuals.
"""

import io
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mjlab_core.lazy import from_extra
from mujoco.minimize import Verbosity, least_squares

from mjlab_sysid.data.records import Record
from mjlab_sysid.data.windows import cut
from mjlab_sysid.identified import Estimate, Identified
from mjlab_sysid.parameters import FitTerm, Range
from mjlab_sysid.problem import PRIOR, IdentifyCfg, Problem
from mjlab_sysid.progress import FitState, load_state, save_state
from mjlab_sysid.robot import Robot

_PASSES = 2
_Residual = Callable[[np.ndarray], np.ndarray]
_Report = Callable[[int, float, np.ndarray], None]


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
  progress: str | Path | None = None,
  resume: bool = False,
) -> Identified:
  """Fit parameters to records; those that are not identifiable are named and stay at their prior.

  Args:
    robot: The robot on its stand.
    records: Records to fit to, at least one.
    fit: Parameters to fit, at least one.
    cfg: Settings; None for the defaults.
    held_out: Records that are only scored.
    ranges: Operation and bounds by field, such as those of a task's randomisation, where a term gives none.
    on_iteration: Function called after every iteration; a true result ends the fit with what is found so far.
    progress: File that keeps the best parameters after every iteration, and is removed once the fit converged.
    resume: Continue from `progress`, with the same records, parameters and settings.

  Raises:
    FileError: The file to resume from is missing, damaged, or of another fit.
    MjlabError: A record or a parameter is wrong; the message names it.
  """
  cfg = cfg or IdentifyCfg()

  def problem_of(some: Sequence[Record]) -> Problem:
    return Problem(robot, cut(robot, some, cfg.window), fit, ranges or {}, cfg)

  problem = problem_of(records)
  fitting = _Fit(problem, cfg, on_iteration, None if progress is None else Path(progress), resume)
  x, reasons = fitting.run()
  identifiable = _without(reasons)
  jacobian, variance = problem.jacobian(x)
  information = problem.information(jacobian / math.sqrt(variance), identifiable)
  numbers = problem.numbers(x[:, None])[0].tolist()
  rows = zip(problem.parameters, numbers, information.std.tolist(), reasons, strict=True)
  traces = problem.traces(x, is_held_out=False)
  if held_out:
    traces += problem_of(held_out).traces(x, is_held_out=True)
  return Identified(
    estimates=tuple(Estimate(*row) for row in rows),
    information=information,
    traces=tuple(traces),
    period=problem.windows.timestep * problem.windows.substeps,
    sources=tuple(dict.fromkeys(record.source for record in records)),
    overlay=problem.overlay(x, identifiable),
    stopped=fitting.stopped,
  )


def _without(reasons: Sequence[str]) -> np.ndarray:
  """Return True for the parameters without a reason against them, bool (parameters,)."""
  return np.array([not reason for reason in reasons])


class _Fit:
  """Passes of a solver, which the caller may end, and whose state is kept in a file."""

  def __init__(
    self,
    problem: Problem,
    cfg: IdentifyCfg,
    on_iteration: Callable[[Progress], bool | None] | None,
    file: Path | None,
    is_resumed: bool,
  ) -> None:
    self._problem, self._cfg, self._on_iteration, self._file = problem, cfg, on_iteration, file
    # The records do not change; their digest takes time.
    self._key = problem.key
    if is_resumed and file is not None:
      self._state = load_state(file, self._key, problem.count)
    else:
      self._state = FitState(x=problem.off_plateaus(np.zeros(problem.count)))
    self.stopped = False

  def run(self) -> tuple[np.ndarray, list[str]]:
    """Fit all parameters, then the identifiable ones; return the candidate, and the reasons against the others."""
    if not self._state.reasons:
      x = self._solve("fit", np.ones(self._problem.count, dtype=bool))
      reasons = self._problem.reasons(x)
      self._state = FitState(x=np.where(_without(reasons), x, 0.0), reasons=reasons)
    reasons = self._state.reasons
    identifiable = _without(reasons)
    if identifiable.any() and not identifiable.all():
      self._solve("fit identifiable parameters", identifiable)
    if self._file is not None and not self.stopped:
      self._file.unlink(missing_ok=True)
    return self._state.x, reasons

  def _solve(self, stage: str, free: np.ndarray) -> np.ndarray:
    """Return the best candidate that differs from the state's in the free parameters alone."""
    problem, state = self._problem, self._state
    state.x = np.clip(state.x, problem.lower, problem.upper)
    # States depend on parameters, so their uncertainty is linearised again after the first pass.
    while state.passes < _PASSES and not self.stopped:
      problem.marginalise(state.x)
      self._pass(stage, free)
      state.passes += not self.stopped
    return state.x

  def _pass(self, stage: str, free: np.ndarray) -> None:
    problem, x = self._problem, self._state.x.copy()

    def residual(z: np.ndarray) -> np.ndarray:
      full = np.repeat(x[:, None], z.shape[1], 1)
      full[free] = z
      return np.concatenate((problem.whitened(full), z / PRIOR))

    def report(iteration: int, cost: float, candidate: np.ndarray) -> None:
      self._state.x = x.copy()
      self._state.x[free] = candidate
      if self._file is not None:
        save_state(self._state, self._file, self._key)
      if self._on_iteration is not None and self._on_iteration(Progress(stage, iteration, cost)):
        raise StopIteration

    search = self._evolve if self._cfg.solver == "cma" else self._descend
    try:
      best = search(residual, x[free], [problem.lower[free], problem.upper[free]], report)
      self._state.x = x.copy()
      self._state.x[free] = best
    except StopIteration:
      self.stopped = True

  def _descend(self, residual: _Residual, x: np.ndarray, bounds: list[np.ndarray], report: _Report) -> np.ndarray:
    best, _ = least_squares(
      x,
      residual,
      bounds=bounds,
      eps=self._problem.steps.parameter,
      xtol=1e-4,
      gtol=1e-3,
      mu_min=1e-3,
      mu_factor=10.0,
      max_iter=self._cfg.iterations,
      verbose=Verbosity.SILENT,
      output=io.StringIO(),
      iter_callback=lambda trace: report(len(trace), float(trace[-1].objective), trace[-1].candidate[:, 0]),
    )
    return best

  def _evolve(self, residual: _Residual, x: np.ndarray, bounds: list[np.ndarray], report: _Report) -> np.ndarray:
    with from_extra("cma", "mjlab-sysid", "CMA-ES"):
      import cma
    count = len(x)
    # CMA-ES needs two dimensions: a single parameter gets a second one without effect.
    start, *limits = (np.resize(values, max(count, 2)).tolist() for values in (x, *bounds))
    options = {"bounds": limits, "seed": self._cfg.seed + 1, "verbose": -9, "maxiter": self._cfg.iterations}
    search, best = cma.CMAEvolutionStrategy(start, 0.3, options), x
    while not search.stop():
      candidates = search.ask()
      costs = 0.5 * np.square(residual(np.array(candidates)[:, :count].T)).sum(0)
      search.tell(candidates, costs.tolist())
      best = np.asarray(search.result.xbest)[:count]
      report(search.countiter, float(search.result.fbest), best)
    return best
