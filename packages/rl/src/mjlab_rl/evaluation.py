"""How well a policy does a task: fixed scenarios, whole first episodes, intervals."""

import dataclasses
import math
import re
import statistics
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import torch

from mjlab_rl.env_protocol import RlEnv

RESAMPLES = 2000
"""Draws of the bootstrap."""
CONFIDENCE = 0.95

Policy = Callable[[Any], torch.Tensor]
"""Actions, (num_envs, num_actions), for observations by group. One that remembers also has `reset(dones)`."""
Progress = Callable[[int, int, int], None]
"""Called after each step with its number, how many worlds still play, and how many there are."""


class EvaluationError(ValueError):
  """An evaluation that cannot be run, or a threshold that means nothing; the message says why."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Episodes:
  """The first episode of every world. All tensors are float64 on the CPU."""

  length: torch.Tensor
  """Steps, int64 (num_envs,)."""
  has_failed: torch.Tensor
  """Whether it was terminated, bool (num_envs,). One that still played at the last step has not failed."""
  has_ended: torch.Tensor
  """Whether it ended before the last step, bool (num_envs,)."""
  total: torch.Tensor
  """Sum of rewards, (num_envs,)."""
  values: dict[str, torch.Tensor]
  """What was measured in each step by name, (steps, num_envs); NaN after the end."""

  def mean(self, name: str) -> torch.Tensor:
    """Mean of a measure over the steps of each episode, (num_envs,)."""
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
  """Play until the first episode of every world is over.

  Worlds whose episode ended go on playing, for the environment resets them by itself, but nothing of that counts.

  Args:
    env: The environment; reset first.
    policy: What plays.
    measure: What the step just done was like, (num_envs,) by name, as it was before ended worlds were reset: such as
      the values of the metrics manager. A step that ends an episode so counts with its terminal state.
    max_steps: When to stop at the latest.
    seed: Restarts the environment's generator.
    begin: Called once, when all episodes have begun and before the first step: to note how they begin.
    progress: Told of every step.
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
  """A mean over episodes and where it may as well have been."""

  mean: float
  low: float
  high: float
  count: int
  """Episodes."""


def bootstrap(values: torch.Tensor, *, seed: int = 0) -> Interval:
  """Mean of (n,) numbers with its 95 % percentile interval by the bootstrap (Efron, 1979); NaNs are left out."""
  values = values[~torch.isnan(values)].double()
  count = values.numel()
  if count == 0:
    return Interval(mean=math.nan, low=math.nan, high=math.nan, count=0)
  generator = torch.Generator().manual_seed(seed)
  draws = torch.randint(count, (RESAMPLES, count), generator=generator)
  means = values[draws].mean(1)
  tail = 0.5 * (1.0 - CONFIDENCE)
  low, high = torch.quantile(means, torch.tensor([tail, 1.0 - tail], dtype=torch.float64)).tolist()
  return Interval(mean=float(values.mean()), low=low, high=high, count=count)


def wilson(values: torch.Tensor) -> Interval:
  """Share of ones among (n,) zeros and ones with its 95 % interval by the score test (Wilson, 1927); NaNs are left out.

  Unlike by the bootstrap, twelve successes in twelve episodes are no certainty.

  Raises:
    ValueError: a number that is neither.
  """
  values = values[~torch.isnan(values)].double()
  count = values.numel()
  if not ((values == 0.0) | (values == 1.0)).all():
    raise ValueError("a share is of zeros and ones")
  if count == 0:
    return Interval(mean=math.nan, low=math.nan, high=math.nan, count=0)
  mean = float(values.mean())
  weight = statistics.NormalDist().inv_cdf(0.5 + 0.5 * CONFIDENCE) ** 2 / count
  middle = (mean + 0.5 * weight) / (1.0 + weight)
  reach = math.sqrt(weight * mean * (1.0 - mean) + 0.25 * weight**2) / (1.0 + weight)
  return Interval(mean=mean, low=max(middle - reach, 0.0), high=min(middle + reach, 1.0), count=count)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evaluation:
  """What came out: intervals by group and metric, and curves over time."""

  groups: dict[str, dict[str, Interval]]
  """By group ("all" and those of the task: clips, commands, pushes), then by metric."""
  curves: dict[str, dict[str, list[float]]]
  """By metric, then by group: its mean in each second of an episode, over the worlds that still played."""
  units: dict[str, str]
  """Unit of each metric."""

  def to_json(self) -> dict[str, Any]:
    """Plain data; NaN becomes None."""

    def number(value: float) -> float | None:
      return value if math.isfinite(value) else None

    groups = {
      group: {
        name: {"mean": number(i.mean), "low": number(i.low), "high": number(i.high), "count": i.count}
        for name, i in metrics.items()
      }
      for group, metrics in self.groups.items()
    }
    curves = {
      metric: {group: [number(value) for value in values] for group, values in by_group.items()}
      for metric, by_group in self.curves.items()
    }
    return {"groups": groups, "curves": curves, "units": dict(self.units), "confidence": CONFIDENCE}

  def table(self) -> str:
    """One line per group, one column per metric: the mean and its interval."""
    names = list(dict.fromkeys(name for metrics in self.groups.values() for name in metrics))
    head = ["", "episodes", *(f"{name} [{self.units[name]}]" if self.units.get(name) else name for name in names)]
    rows = [head]
    for group, metrics in self.groups.items():
      count = max((interval.count for interval in metrics.values()), default=0)
      cells = [_cell(metrics[name]) if name in metrics else "-" for name in names]
      rows.append([group, str(count), *cells])
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    return "\n".join(
      "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def _cell(interval: Interval) -> str:
  if not math.isfinite(interval.mean):
    return "-"
  return f"{interval.mean:.3g} ({interval.low:.3g} .. {interval.high:.3g})"


def summarize(
  metrics: Mapping[str, torch.Tensor],
  groups: Mapping[str, torch.Tensor],
  *,
  units: Mapping[str, str],
  values: Mapping[str, torch.Tensor] | None = None,
  steps_per_second: int = 1,
) -> Evaluation:
  """Intervals of all episodes and of each group.

  Args:
    metrics: One number per episode by name, (num_envs,); NaN where there is none. What is called ..._rate is a share
      of episodes, each of which counts as 0 or 1.
    groups: Members of each group, bool (num_envs,); groups may overlap. A group of everybody says nothing new and is
      left out.
    units: Unit of each metric.
    values: What becomes curves, (steps, num_envs) by metric, NaN after an episode's end.
    steps_per_second: Steps that a point of a curve is the mean of.
  """
  some = next(iter(metrics.values()))
  members = {"all": torch.ones_like(some, dtype=torch.bool)}
  members |= {name: mask.cpu() for name, mask in groups.items() if not bool(mask.all())}
  curves: dict[str, dict[str, list[float]]] = {}
  for metric, table in (values or {}).items():
    seconds = [table[i : i + steps_per_second] for i in range(0, len(table), steps_per_second)]
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
  """How a task family judges policies. A dataclass, whose fields are settings."""

  def configure(self, cfg: Any) -> Any:
    """The environment configuration to evaluate in, from that of training (a copy, which may be changed)."""
    ...

  def run(self, env: Any, policy: Policy, progress: Progress | None = None) -> Evaluation:
    """Judge a policy in an environment of `configure`."""
    ...


@dataclasses.dataclass(kw_only=True)
class ReturnEvaluation:
  """Returns, lengths and failures of episodes as training has them: what can be said of any task."""

  episodes: int = 256
  """Worlds, each of which plays one episode."""
  seed: int = 0
  """Of the environment."""

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
  """What a metric must reach: "success_rate>=0.95", or for one group "dance:success_rate>=0.8"."""

  group: str
  metric: str
  at_least: bool
  bound: float

  @classmethod
  def parse(cls, text: str) -> "Threshold":
    """Read one.

    Raises:
      EvaluationError: It is not of the form [GROUP:]METRIC>=NUMBER or <=.
    """
    match = re.fullmatch(r"(?:(?P<group>.+):)?(?P<metric>[\w/]+)\s*(?P<sign>>=|<=)\s*(?P<bound>\S+)", text.strip())
    try:
      bound = float(match["bound"]) if match else math.nan
    except ValueError:
      bound = math.nan
    if match is None or math.isnan(bound):
      raise EvaluationError(f"threshold {text!r}: expected [GROUP:]METRIC>=NUMBER or METRIC<=NUMBER")
    return cls(match["group"] or "all", match["metric"], match["sign"] == ">=", bound)

  def check(self, evaluation: Evaluation) -> tuple[bool, str]:
    """Whether the mean reaches it, and a line that says so.

    Raises:
      EvaluationError: There is no such group or metric.
    """
    from mjlab_core import unknown

    if self.group not in evaluation.groups:
      raise EvaluationError(unknown("group", self.group, list(evaluation.groups), owner="threshold"))
    metrics = evaluation.groups[self.group]
    if self.metric not in metrics:
      raise EvaluationError(unknown("metric", self.metric, list(metrics), owner="threshold"))
    mean = metrics[self.metric].mean
    # A NaN reaches nothing.
    reached = mean >= self.bound if self.at_least else mean <= self.bound
    sign = ">=" if self.at_least else "<="
    return reached, f"{self.group}: {self.metric} {mean:.4g} {sign} {self.bound:g}: {'yes' if reached else 'NO'}"
