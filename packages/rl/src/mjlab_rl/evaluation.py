"""Evaluation of policies: fixed scenarios, whole first episodes, confidence intervals."""

import dataclasses
import math
import re
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import msgspec
import numpy as np
import torch
from mjlab_core.errors import ConfigError
from mjlab_core.io.tables import table
from mjlab_core.names import check_name
from mjlab_core.policies import Policy

from mjlab_rl.env_protocol import RlEnv

RESAMPLES = 2000
"""Draws of the bootstrap."""
CONFIDENCE = 0.95
_THRESHOLD = re.compile(r"(?:(.+):)?([\w/]+)\s*(>=|<=)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)")

Progress = Callable[[int, int, int], None]
"""Function called after each step with its number, the number of worlds that still play, and that of all worlds."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Episodes:
  """The first episode of every world. All tensors are float64 on the CPU."""

  length: torch.Tensor
  """Steps, int64 (num_envs,)."""
  has_failed: torch.Tensor
  """True for terminated episodes, bool (num_envs,); one that still played at the last step has not failed."""
  has_ended: torch.Tensor
  """True for episodes that ended before the last step, bool (num_envs,)."""
  total: torch.Tensor
  """Sum of rewards, (num_envs,)."""
  values: dict[str, torch.Tensor]
  """Measures of each step by name, (steps, num_envs); NaN after the end of an episode."""

  def mean(self, name: str) -> torch.Tensor:
    """Return the mean of a measure over the steps of each episode, (num_envs,)."""
    return self.values[name].nanmean(0)


def play_first_episodes(
  env: RlEnv,
  policy: Policy,
  measure: Callable[[], Mapping[str, torch.Tensor]],
  *,
  max_steps: int,
  seed: int | None = None,
  begin: Callable[[], None] | None = None,
  progress: Progress | None = None,
) -> Episodes:
  """Play until the first episode of every world has ended; later episodes do not count.

  Args:
    env: The environment; reset first.
    policy: Source of actions.
    measure: Measures of the last step by name, (num_envs,), taken before ended worlds were reset, such as the values of
      the metrics manager. The step that ends an episode counts with its terminal state.
    max_steps: Limit of steps.
    seed: Seed of the environment's generator; None: it goes on.
    begin: Called once, after the reset and before the first step.
    progress: Called after every step.
  """
  with torch.no_grad():
    observations, _ = env.reset(seed=seed)
    if begin is not None:
      begin()
    n = env.num_envs
    playing = torch.ones(n, dtype=torch.bool, device=env.device)
    length = torch.zeros(n, dtype=torch.int64, device=env.device)
    failed, total = torch.zeros_like(playing), torch.zeros(n, dtype=torch.float64, device=env.device)
    rows: dict[str, list[torch.Tensor]] = {}
    for step in range(1, max_steps + 1):
      observations, reward, terminated, truncated, _ = env.step(policy(observations))
      for name, value in measure().items():
        row = value.double().masked_fill(~playing, math.nan)
        rows.setdefault(name, []).append(row.cpu())
      length += playing
      total += reward.double().masked_fill(~playing, 0.0)
      failed |= playing & terminated
      dones = terminated | truncated
      playing &= ~dones
      if (reset := getattr(policy, "reset", None)) is not None:
        reset(dones)
      left = int(playing.sum())
      if progress is not None:
        progress(step, left, n)
      if left == 0:
        break
  return Episodes(
    length=length.cpu(),
    has_failed=failed.cpu(),
    has_ended=~playing.cpu(),
    total=total.cpu(),
    values={name: torch.stack(values) for name, values in rows.items()},
  )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Interval:
  """Mean over episodes with its confidence interval."""

  mean: float
  low: float
  high: float
  count: int
  """Episodes."""

  def __str__(self) -> str:
    return f"{self.mean:.3g} ({self.low:.3g} .. {self.high:.3g})" if math.isfinite(self.mean) else "-"


def bootstrap(values: torch.Tensor) -> Interval:
  """Return the mean of (n,) numbers with its 95 % percentile interval by the bootstrap (Efron, 1979), without NaNs."""
  from scipy import stats

  kept = values[~values.isnan()].double().numpy()
  mean = low = high = float(kept.mean()) if len(kept) else math.nan
  if len(kept) > 1:
    low, high = stats.bootstrap(
      (kept,), np.mean, n_resamples=RESAMPLES, confidence_level=CONFIDENCE, method="percentile", rng=0
    ).confidence_interval
  return Interval(mean=mean, low=float(low), high=float(high), count=len(kept))


def wilson(values: torch.Tensor) -> Interval:
  """Return the share of ones among (n,) zeros and ones with its 95 % interval by the score test (Wilson, 1927).

  NaNs are left out. Unlike the bootstrap, it gives twelve successes in twelve episodes an interval.
  """
  from scipy import stats

  kept = values[~values.isnan()]
  if not len(kept):
    return Interval(mean=math.nan, low=math.nan, high=math.nan, count=0)
  found = stats.binomtest(int(kept.sum()), len(kept))
  low, high = found.proportion_ci(CONFIDENCE, method="wilson")
  return Interval(mean=float(found.statistic), low=float(low), high=float(high), count=len(kept))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evaluation:
  """Result of an evaluation: intervals by group and metric, and curves over time."""

  groups: dict[str, dict[str, Interval]]
  """Intervals by group ("all", and groups of the task such as clips, commands or pushes), then by metric."""
  curves: dict[str, dict[str, list[float]]]
  """Means in each second of an episode, over the worlds that still played, by metric, then by group."""
  units: dict[str, str]
  """Unit of each metric."""

  def to_json(self) -> dict[str, Any]:
    """Return plain data, in which NaN is None."""
    # msgspec writes NaN as null.
    return msgspec.json.decode(msgspec.json.encode({**vars(self), "confidence": CONFIDENCE}))

  def table(self) -> str:
    """Return a table with one line per group and one column per metric: the mean and its interval."""
    names = (f"{name} [{self.units[name]}]" if self.units.get(name) else name for name in self.groups["all"])
    rows = [
      [group, str(max(interval.count for interval in metrics.values())), *map(str, metrics.values())]
      for group, metrics in self.groups.items()
    ]
    return table(["", "episodes", *names], rows)


def summarize(
  metrics: Mapping[str, torch.Tensor],
  groups: Mapping[str, torch.Tensor],
  *,
  units: Mapping[str, str],
  values: Mapping[str, torch.Tensor] | None = None,
  steps_per_second: int = 1,
) -> Evaluation:
  """Return intervals of all episodes and of each group.

  Args:
    metrics: One number per episode by name, (num_envs,); NaN if there is none. A metric called ..._rate is a share of
      episodes, each 0 or 1.
    groups: Members of each group, bool (num_envs,); groups may overlap. A group of all episodes is left out.
    units: Unit of each metric.
    values: Values of curves by metric, (steps, num_envs); NaN after the end of an episode.
    steps_per_second: Number of steps in each point of a curve.
  """
  some = next(iter(metrics.values()))
  members = {"all": torch.ones_like(some, dtype=torch.bool)}
  members |= {name: mask.cpu() for name, mask in groups.items() if not bool(mask.all())}
  curves: dict[str, dict[str, list[float]]] = {}
  for metric, steps in (values or {}).items():
    seconds = [steps[i : i + steps_per_second] for i in range(0, len(steps), steps_per_second)]
    curves[metric] = {name: [float(second[:, mask].nanmean()) for second in seconds] for name, mask in members.items()}
  return Evaluation(
    groups={
      name: {
        metric: (wilson if metric.endswith("_rate") else bootstrap)(numbers[mask])
        for metric, numbers in metrics.items()
      }
      for name, mask in members.items()
    },
    curves=curves,
    units=dict(units),
  )


class Evaluator(Protocol):
  """Evaluation of one task family; a dataclass whose fields are settings."""

  def configure(self, cfg: Any) -> Any:
    """Return the environment configuration for evaluation; `cfg` is a copy of that of training and may be changed."""
    ...

  def run(self, env: Any, policy: Policy, progress: Progress | None = None) -> Evaluation:
    """Evaluate a policy in an environment of `configure`."""
    ...


@dataclasses.dataclass(kw_only=True)
class ReturnEvaluation:
  """Returns, lengths and failures of episodes, which every task has."""

  episodes: int = 256
  """Number of worlds; each plays one episode."""
  seed: int = 0
  """Seed of the environment."""

  def configure(self, cfg: Any) -> Any:
    cfg.scene.num_envs, cfg.seed = self.episodes, self.seed
    return cfg

  def run(self, env: Any, policy: Policy, progress: Progress | None = None) -> Evaluation:
    played = play_first_episodes(env, policy, dict, max_steps=env.max_episode_length, seed=self.seed, progress=progress)
    metrics = {
      "return": played.total,
      "failure_rate": played.has_failed.double(),
      "length": played.length.double(),
    }
    return summarize(metrics, {}, units={"length": "steps"})


@dataclasses.dataclass(frozen=True)
class Threshold:
  """Limit of a metric: "success_rate>=0.95", or for one group "dance:success_rate>=0.8"."""

  group: str
  metric: str
  at_least: bool
  bound: float

  @classmethod
  def parse(cls, text: str) -> "Threshold":
    """Read a threshold.

    Raises:
      ConfigError: It is not of the form [GROUP:]METRIC>=NUMBER or <=.
    """
    match = _THRESHOLD.fullmatch(text.strip())
    if match is None:
      raise ConfigError(f"threshold {text!r}: expected [GROUP:]METRIC>=NUMBER or METRIC<=NUMBER")
    group, metric, sign, bound = match.groups()
    return cls(group or "all", metric, sign == ">=", float(bound))

  def check(self, evaluation: Evaluation) -> tuple[bool, str]:
    """Return True if the mean reaches the limit, and a line for the reader.

    Raises:
      UnknownNameError: There is no such group or metric.
    """
    metrics = evaluation.groups[check_name("group", self.group, evaluation.groups, "threshold")]
    mean = metrics[check_name("metric", self.metric, metrics, "threshold")].mean
    reached = mean >= self.bound if self.at_least else mean <= self.bound
    sign = ">=" if self.at_least else "<="
    return reached, f"{self.group}: {self.metric} {mean:.4g} {sign} {self.bound:g}: {'yes' if reached else 'NO'}"
