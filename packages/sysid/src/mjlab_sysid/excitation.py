"""Design of excitations: sums of sines within the limits of a robot that improve the least identifiable direction.

A candidate is scored by the smallest singular value of the Jacobian of a simulated record, in units of noise, of
parameters in units of half their bounds, with the first states of windows marginalised as in a fit. Candidates are
drawn, scaled joint by joint to the limits, and the best of each round is varied in the next.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import mujoco
import numpy as np
import torch
from mjlab_core.constraints import Limits, Positive, PositiveCount, check_fields, require
from mjlab_core.errors import MjlabError
from mjlab_core.io.tables import table
from mjlab_core.names import match_names, match_values_full

from mjlab_sysid.data.records import Record
from mjlab_sysid.data.windows import cut
from mjlab_sysid.identified import Information
from mjlab_sysid.identify import Progress
from mjlab_sysid.parameters import FitTerm, Parameter, Range
from mjlab_sysid.problem import IdentifyCfg, Problem
from mjlab_sysid.robot import Robot
from mjlab_sysid.worlds import Worlds

_LOWEST = 0.2
_RAMP = 1.0
_ATTEMPTS = 8
# Velocities of encoders are noisier than positions by this factor [1/s].
_VELOCITY_NOISE = 20.0


@dataclass(kw_only=True)
class ExcitationCfg:
  """Settings of a design."""

  seconds: Positive = 10.0
  """Length [s]."""
  period: Positive = 0.01
  """Time between two commands, and between two rows of the record [s]."""
  sines: PositiveCount = 5
  """Sines of each joint."""
  highest: Positive = 4.0
  """Highest frequency [Hz]."""
  share: Annotated[float, Limits(gt=0, le=1)] = 0.7
  """Share of the limits that is used: of the way from the pose to the ends of joints, of velocities and efforts."""
  velocity: Positive = 10.0
  """Velocity limit of joints whose actuator config has none [rad/s or m/s]."""
  noise: Positive = 1e-3
  """Expected noise of positions [rad or m]."""
  rounds: PositiveCount = 3
  """Rounds."""
  candidates: PositiveCount = 6
  """Candidates of a round."""
  window: Positive = 0.3
  """Length of the windows of the fit [s]."""
  threads: Annotated[int, Limits(ge=0)] = 0
  """Threads of the rollouts; 0 for all cores."""
  seed: int = 0
  """Seed of the draws."""

  def __post_init__(self) -> None:
    check_fields(self, "ExcitationCfg")


class Peak(NamedTuple):
  """Extreme values of a signal of a joint under an excitation."""

  joint: str
  """Name of the joint."""
  signal: str
  """`position`, `velocity` or `effort`."""
  lowest: float
  """Lowest value, in SI units."""
  highest: float
  """Highest value."""
  limits: tuple[float, float]
  """Lower and upper limit of the signal."""


@dataclass(frozen=True, kw_only=True)
class Excitation:
  """Commands for a robot, and the information of a record of them."""

  record: Record
  """Commands (`position_target`), and the positions, velocities and efforts that the model expects."""
  parameters: tuple[Parameter, ...]
  """Parameters that it is for."""
  before: Information
  """Information from one slow sine in every joint, within the same limits."""
  after: Information
  """Information from the excitation."""
  peaks: tuple[Peak, ...]
  """Extreme values of each moved joint."""
  stopped: bool
  """True if the search was ended early."""

  @property
  def commands(self) -> Record:
    """Commands alone."""
    return replace(self.record, signals={"position_target": self.record.signals["position_target"]})

  def summary(self) -> str:
    """Return a table of the parameters, the smallest singular values, and a table of the limits."""
    stds = np.stack((self.before.std, self.after.std), 1)
    rows = [
      (parameter.name, *(f"{100.0 * std / parameter.half:.2g} %" for std in of_parameter))
      for parameter, of_parameter in zip(self.parameters, stds, strict=True)
    ]
    before, after = (information.singular_values[-1] for information in (self.before, self.after))
    peaks = [
      (peak.joint, peak.signal, *(f"{lo:.3g} .. {hi:.3g}" for lo, hi in ((peak.lowest, peak.highest), peak.limits)))
      for peak in self.peaks
    ]
    return "\n\n".join(
      (
        table(("parameter", "std, one slow sine [of half its bounds]", "std, excitation"), rows),
        f"smallest singular value: {before:.3g} with one slow sine, {after:.3g} with the excitation",
        table(("joint", "signal", "reached", "limits [SI]"), peaks),
      )
    )


class _Waves(NamedTuple):
  """Sines of joints, (sines, joints) each."""

  frequency: np.ndarray
  amplitude: np.ndarray
  phase: np.ndarray

  def shape(self, time: np.ndarray) -> np.ndarray:
    """Return waves that begin and end at rest at 0, of amplitude 1, (rows, joints)."""
    angle = 2.0 * np.pi * self.frequency * time[:, None, None] + self.phase
    waves = (self.amplitude * np.sin(angle)).sum(1)
    ramp = np.clip(np.minimum(time, time[-1] - time) / _RAMP, 0.0, 1.0)
    waves *= (ramp * ramp * (3.0 - 2.0 * ramp))[:, None]
    return waves / np.abs(waves).max(0)


def design_excitation(
  robot: Robot,
  fit: Sequence[FitTerm],
  cfg: ExcitationCfg | None = None,
  *,
  joints: str | Sequence[str] = ".*",
  ranges: Mapping[str, Range] | None = None,
  on_iteration: Callable[[Progress], bool | None] | None = None,
) -> Excitation:
  """Return commands that identify parameters well, and which the model of the robot can follow within its limits.

  Positions, velocities and efforts stay within `share` of their limits, and there are no contacts beyond those of the
  pose.

  Args:
    robot: The robot on its stand.
    fit: Parameters to be fitted later, at least one.
    cfg: Settings; None for the defaults.
    joints: Pattern of the joints to move; the others hold their pose.
    ranges: Operation and bounds by field, as in `identify`.
    on_iteration: Function called after every candidate; a true result ends the search with the best one so far.

  Raises:
    MjlabError: A parameter is wrong, or a joint has no room to move.
  """
  search = _Search(robot, fit, cfg or ExcitationCfg(), joints, ranges or {})
  return search.run(on_iteration)


class _Search:
  """Search for the best excitation, with the worlds that candidates are tried in."""

  def __init__(
    self,
    robot: Robot,
    fit: Sequence[FitTerm],
    cfg: ExcitationCfg,
    joints: str | Sequence[str],
    ranges: Mapping[str, Range],
  ) -> None:
    self._robot, self._fit, self._cfg, self._ranges = robot, fit, cfg, ranges
    if robot.base:
      raise MjlabError("excitations are designed for a robot on a stand")
    self._worlds = Worlds(robot, cfg.candidates, threads=cfg.threads)
    driven = self._worlds.actuators.driven("joint")
    _, self.names = match_names(joints, driven, what="driven joint", owner="excitation")
    self._columns = [robot.joints.index(name) for name in self.names]
    self._pose = robot.pose[robot.addresses(robot.joints)[0]]
    limits = robot.ranges()
    self._range = np.array([limits[name] for name in self.names])
    self._middle = self._pose[self._columns]
    self._room = np.minimum(np.abs(self._range - self._middle[:, None]).min(1), np.pi)
    if (full := np.flatnonzero(self._room < 1e-3)).size:
      raise MjlabError(f"joint '{self.names[full[0]]}' stands at the end of its range; choose another pose")
    self._limits = {
      signal: np.array([_limit(robot, f"{signal}_limit", name, otherwise) for name in self.names])
      for signal, otherwise in (("velocity", cfg.velocity), ("effort", np.inf))
    }
    self._random = np.random.default_rng(cfg.seed)
    self._time = cfg.period * np.arange(round(cfg.seconds / cfg.period))
    self._problem: Problem | None = None

  def run(self, on_iteration: Callable[[Progress], bool | None] | None) -> Excitation:
    """Search, and return the best excitation."""
    cfg, count = self._cfg, len(self.names)
    slow = _Waves(np.full((1, count), 0.5), np.ones((1, count)), np.pi * np.linspace(0.0, 1.0, count)[None])
    touches = "the robot touches something as soon as it moves; choose another pose or fewer joints"
    plain = require(self._safe([slow] * cfg.candidates)[0], Record, touches)
    before = self._information(plain)
    best, waves, known, tried = plain, slow, before, 0

    def result(stopped: bool) -> Excitation:
      assert self._problem is not None
      return Excitation(
        record=best,
        parameters=tuple(self._problem.parameters),
        before=before,
        after=known,
        peaks=self._peaks(best),
        stopped=stopped,
      )

    for round_ in range(cfg.rounds):
      drawn = [self._draw() if round_ == 0 else self._vary(waves) for _ in range(cfg.candidates)]
      for candidate, record in zip(drawn, self._safe(drawn), strict=True):
        if record is None:
          continue
        found, tried = self._information(record), tried + 1
        if found.singular_values[-1] > known.singular_values[-1]:
          best, waves, known = record, candidate, found
        if on_iteration is not None and on_iteration(Progress("design", tried, float(known.singular_values[-1]))):
          return result(stopped=True)
    return result(stopped=False)

  def _draw(self) -> _Waves:
    shape, random = (self._cfg.sines, len(self.names)), self._random
    frequency = np.exp(random.uniform(np.log(_LOWEST), np.log(self._cfg.highest), shape))
    return _Waves(frequency, random.uniform(0.2, 1.0, shape), random.uniform(0.0, 2.0 * np.pi, shape))

  def _vary(self, waves: _Waves) -> _Waves:
    fresh = self._draw()
    if waves.frequency.shape != fresh.frequency.shape:
      return fresh
    random, shape = self._random, fresh.frequency.shape
    varied = _Waves(
      np.clip(waves.frequency * np.exp(0.2 * random.normal(size=shape)), _LOWEST, self._cfg.highest),
      waves.amplitude * np.exp(0.4 * random.normal(size=shape)),
      waves.phase + 0.5 * random.normal(size=shape),
    )
    is_fresh = random.random(shape) < 0.1
    return _Waves(*(np.where(is_fresh, new, old) for new, old in zip(fresh, varied, strict=True)))

  def _safe(self, drawn: Sequence[_Waves]) -> list[Record | None]:
    """Return a record of each candidate, as large as the limits allow; None for one that touches something."""
    share = self._cfg.share
    shapes = np.stack([waves.shape(self._time) for waves in drawn])
    size = np.tile(share * self._room, (len(drawn), 1))
    records: list[Record | None] = [None] * len(drawn)
    for _ in range(_ATTEMPTS):
      rolled = self._roll(self._middle + shapes * size[:, None])
      for place, record in enumerate(rolled):
        worst = self._load(record)
        if records[place] is not None:
          continue
        if not np.all(worst <= share):
          size[place] *= np.where(worst > share, 0.95 * share / np.maximum(worst, 1e-9), 1.0)
        elif (factor := self._free(record)) < 1.0:
          size[place] *= 0.95 * factor
        else:
          records[place] = record
      if all(record is not None for record in records):
        break
    return records

  def _roll(self, commands: np.ndarray) -> list[Record]:
    """Return the records of commands, (candidates, rows, moved joints), without noise; NaN where one diverged."""
    worlds, robot = self._worlds, self._robot
    count, rows = commands.shape[:2]
    targets = np.tile(self._pose, (count, rows, 1))
    targets[:, :, self._columns] = commands
    substeps = max(1, round(self._cfg.period / float(robot.model.opt.timestep)))
    worlds.begin(np.tile((self._pose, np.zeros_like(self._pose)), (count, 1, 1)))
    still = torch.zeros(count, len(robot.joints), dtype=torch.float64)
    seen = {name: np.empty((count, rows, len(robot.joints))) for name in ("position", "velocity", "effort")}
    for row in range(rows):
      for name in ("position", "velocity"):
        seen[name][:, row] = worlds.read(name)
      wanted = {"position_target": torch.from_numpy(targets[:, row]), "velocity_target": still, "effort_target": still}
      for _ in range(substeps):
        worlds.step(wanted)
      seen["effort"][:, row] = worlds.read("effort")
    columns = self._columns
    return [
      Record(
        source="excitation",
        joints=tuple(self.names),
        time=self._time,
        signals={
          "position_target": commands[place],
          **{name: np.nan_to_num(values[place][:, columns], nan=1e9) for name, values in seen.items()},
        },
      )
      for place in range(count)
    ]

  def _load(self, record: Record) -> np.ndarray:
    """Return the share of the limits that each joint uses, (moved joints,)."""
    away = np.abs(np.concatenate([record.signals[name] for name in ("position", "position_target")]) - self._middle)
    others = [np.abs(record.signals[signal]).max(0) / limit for signal, limit in self._limits.items()]
    return np.max((away.max(0) / self._room, *others), 0)

  def _free(self, record: Record) -> float:
    """Return a factor of the motion about the pose that touches nothing more than the pose does."""
    model = self._robot.model
    data = mujoco.MjData(model)
    addresses, _ = self._robot.addresses(self.names)
    data.qpos[:] = self._robot.pose
    mujoco.mj_fwdPosition(model, data)
    usual, factor = data.ncon, 1.0
    for away in record.signals["position"] - self._middle:
      while factor > 0.01:
        data.qpos[addresses] = self._middle + factor * away
        mujoco.mj_fwdPosition(model, data)
        if data.ncon <= usual:
          break
        factor *= 0.9
    return factor

  def _peaks(self, record: Record) -> tuple[Peak, ...]:
    limits = {"position": self._range}
    limits |= {signal: np.stack((-limit, limit), 1) for signal, limit in self._limits.items()}
    return tuple(
      Peak(name, signal, values.min().item(), values.max().item(), tuple(of_signal[column].tolist()))
      for column, name in enumerate(self.names)
      for signal, of_signal in limits.items()
      for values in [record.signals[signal][:, column]]
    )

  def _information(self, record: Record) -> Information:
    """Return the information of a record about the parameters at their priors."""
    random, cfg = np.random.default_rng(1), self._cfg
    signals = {"position_target": record.signals["position_target"]}
    for name, noise in (("position", cfg.noise), ("velocity", _VELOCITY_NOISE * cfg.noise)):
      signals[name] = record.signals[name] + random.normal(0.0, noise, record.signals[name].shape)
    windows = cut(self._robot, [replace(record, signals=signals)], cfg.window)
    if self._problem is None:
      settings = IdentifyCfg(window=cfg.window, threads=cfg.threads)
      self._problem = Problem(self._robot, windows, self._fit, self._ranges, settings)
    problem = self._problem
    problem.windows = windows
    start = np.zeros(problem.count)
    problem.marginalise(start)
    return problem.information(problem.jacobian(start)[0], np.ones(problem.count, dtype=bool))


def _limit(robot: Robot, name: str, joint: str, otherwise: float) -> float:
  """Return a limit of a joint from its actuator config."""
  for cfg in robot.actuators:
    values = getattr(cfg, name, None)
    driven = list(cfg.match(robot.joints)) if cfg.transmission_type == "joint" else []
    if values is not None and joint in driven:
      found = match_values_full(values, driven, what="joint", owner=name, default=otherwise)
      return float(found[driven.index(joint)])
  return otherwise
