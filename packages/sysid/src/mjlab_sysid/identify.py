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
from mjlab_core.errors import MjlabError
from mujoco.minimize import Verbosity, least_squares

from mjlab_sysid.identified import Identified, Score, Trace
from mjlab_sysid.parameters import FitTerm, Range
from mjlab_sysid.problem import PRIOR, IdentifyCfg, Problem
from mjlab_sysid.progress import FitState, load_state, save_state
from mjlab_sysid.records import Record
from mjlab_sysid.robot import Robot
from mjlab_sysid.windows import cut

_PASSES = 2


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
  """Fit parameters to records; those that the records cannot tell are named and stay at their prior.

  Args:
    robot: The robot on its stand.
    records: Records to fit to.
    fit: Parameters to fit.
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
  if not fit:
    raise MjlabError("no parameter to fit is given")
  problem = Problem(robot, cut(robot, records, (cfg := cfg or IdentifyCfg()).window), fit, ranges or {}, cfg)
  tested = Problem(robot, cut(robot, held_out, cfg.window), fit, ranges or {}, cfg) if held_out else None
  file = None if progress is None else Path(progress)
  state = FitState(x=np.zeros(problem.count))
  if resume:
    if file is None:
      raise MjlabError("resume needs the file of a fit: progress")
    state = load_state(file, problem.key, problem.count)
  fitting = _Fit(problem, cfg, on_iteration, state, file)
  if not resume:
    state.x = problem.off_plateaus(state.x)
  if state.told is None:
    x = fitting.solve("fit", np.ones(problem.count, dtype=bool))
    told, reasons = problem.identifiable(x, cfg.tell)
    fitting.state = FitState(x=np.where(told, x, 0.0), told=told, reasons=reasons)
  else:
    told, reasons = state.told, state.reasons
  x = fitting.solve("fit what the records tell", told) if told.any() and not told.all() else fitting.state.x
  if file is not None and not fitting.stopped:
    file.unlink(missing_ok=True)
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


def _score(trace: Trace, is_held_out: bool) -> Score:
  before, after = (float(np.sqrt(np.nanmean(np.square(part - trace.measured)))) for part in (trace.before, trace.after))
  return Score(record=trace.record, joint=trace.joint, before=before, after=after, is_held_out=is_held_out)


class _Fit:
  """Passes of a solver, which the caller may end."""

  def __init__(
    self,
    problem: Problem,
    cfg: IdentifyCfg,
    on_iteration: Callable[[Progress], bool | None] | None,
    state: FitState,
    file: Path | None,
  ) -> None:
    self._problem, self._cfg, self._on_iteration, self._file = problem, cfg, on_iteration, file
    self.state = state
    """State that is kept after every iteration."""
    self.stopped = False

  def solve(self, stage: str, free: np.ndarray) -> np.ndarray:
    """Return the best candidate that differs from the state's in the free parameters alone."""
    problem, state = self._problem, self.state
    state.x = np.clip(state.x, problem.lower, problem.upper)
    # States depend on parameters, so that their uncertainty is linearised again at what the first pass finds.
    while state.passes < _PASSES and not self.stopped:
      problem.marginalise(state.x)
      self._pass(stage, free)
      state.passes += not self.stopped
    return state.x

  def _pass(self, stage: str, free: np.ndarray) -> None:
    problem, x = self._problem, self.state.x.copy()
    key = problem.key

    def residual(z: np.ndarray) -> np.ndarray:
      full = np.repeat(x[:, None], z.shape[1], 1)
      full[free] = z
      return np.concatenate((problem.whitened(full), z / PRIOR))

    def report(iteration: int, cost: float, candidate: np.ndarray) -> None:
      self.state.x = x.copy()
      self.state.x[free] = candidate
      if self._file is not None:
        save_state(self.state, self._file, key)
      if self._on_iteration is not None and self._on_iteration(Progress(stage, iteration, cost)):
        raise StopIteration

    try:
      if self._cfg.solver == "cma":
        self._evolve(residual, x[free], problem.lower[free], problem.upper[free], report)
      else:
        best, _ = least_squares(
          x[free],
          residual,
          bounds=[problem.lower[free], problem.upper[free]],
          eps=problem.steps.parameter,
          xtol=1e-4,
          gtol=1e-3,
          mu_min=1e-3,
          mu_factor=10.0,
          max_iter=self._cfg.iterations,
          verbose=Verbosity.SILENT,
          output=io.StringIO(),
          iter_callback=lambda trace: report(len(trace), float(trace[-1].objective), trace[-1].candidate[:, 0]),
        )
        self.state.x = x.copy()
        self.state.x[free] = best
    except StopIteration:
      self.stopped = True

  def _evolve(
    self,
    residual: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    report: Callable[[int, float, np.ndarray], None],
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
      report(search.countiter, float(search.result.fbest), np.asarray(search.result.xbest))
