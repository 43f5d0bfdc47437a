"""Metrics: numbers about an episode that are logged and not optimised."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Literal, get_args

import torch
from mjlab_core import fill_, where_
from mjlab_core.tables import table

from mjlab_managers.binding import Term
from mjlab_managers.term import ManagerTermBaseCfg
from mjlab_managers.vector_manager import FiniteValues, LogBuffer, VectorManager, nan_if_zero

Reduction = Literal["mean", "sum", "last", "max"]

# Columns come in this order, so that each kind is a slice.
_REDUCTIONS: tuple[Reduction, ...] = get_args(Reduction)


@dataclass
class MetricsTermCfg(ManagerTermBaseCfg):
  """Config of a metric: `func(env, **params)` returns float (N,)."""

  _: KW_ONLY
  reduce: Reduction = "mean"
  """Reduction of the values of an episode to one number."""
  per_substep: bool = False
  """True: evaluated after every physics substep and averaged over the substeps of a step."""


class MetricsManager(VectorManager[MetricsTermCfg]):
  """Manager that reduces metrics over episodes.

  A NaN or infinite value counts as 0. An episode without a step is left out.
  """

  cfg_type = MetricsTermCfg

  def _make(self) -> None:
    terms = self._bind_vectors()

    def rank(term: Term) -> int:
      return _REDUCTIONS.index(self._cfgs[term.name].reduce)

    self._terms = sorted(terms, key=rank)
    ranks = [rank(term) for term in self._terms]
    self._num_mean, self._num_added = ranks.count(0), ranks.count(0) + ranks.count(1)
    self._max_start = self._num_added + ranks.count(2)
    self._substep_columns = [i for i, term in enumerate(self._terms) if self._cfgs[term.name].per_substep]
    self._substeps = round(self.env.step_dt / self.env.physics_dt)

    count = len(self._terms)
    self._initial = torch.zeros(1, count, device=self.device)
    self._initial[:, self._max_start :] = -torch.inf
    self._episode = self.state((count,), fill=self._initial)
    self._steps = self.state(dtype=torch.int64)
    self._substep_sums = self.state((len(self._substep_columns),))
    names = [term.name for term in self._terms]
    self._finite = FiniteValues(names, "metrics", self.num_envs, self.device)
    self._log = LogBuffer([f"Episode_Metrics/{name}" for name in names], self.device)

  def compute_substep(self) -> None:
    """Evaluate the per-substep metrics. Call it after every physics substep."""
    if self._substep_columns:
      values = [self._terms[column]() for column in self._substep_columns]
      self._substep_sums.add_(torch.stack(values, dim=1))

  def compute(self) -> None:
    """Evaluate the other metrics and add the step to the episode."""
    if not self._terms:
      return
    values: dict[int, torch.Tensor] = {}
    if self._substep_columns:
      means = (self._substep_sums / self._substeps).unbind(1)
      self._substep_sums.zero_()
      values = dict(zip(self._substep_columns, means, strict=True))
    others = [i for i in range(len(self._terms)) if i not in values]
    values |= dict(zip(others, self.evaluate([self._terms[i] for i in others]), strict=True))
    self._finite.put([values[i] for i in range(len(self._terms))])
    now, added, top = self._finite.values, self._num_added, self._max_start
    if added:
      self._episode[:, :added].add_(now[:, :added])
    if top > added:
      self._episode[:, added:top].copy_(now[:, added:top])
    if top < len(self._terms):
      highest = self._episode[:, top:]
      highest.copy_(torch.maximum(highest, now[:, top:]))
    self._steps.add_(1)

  def get_value(self, name: str) -> torch.Tensor:
    """Return a metric in the last step, terminal states included, (N,).

    Raises:
      UnknownNameError: no such term; the message lists the nearest names.
    """
    columns = {term.name: column for column, term in enumerate(self._terms)}
    return self._finite.values[:, self._lookup(columns, name)]

  def reset(self, mask: torch.Tensor) -> None:
    """Log the metrics of the worlds in `mask`, bool (N,), whose episode had a step, and reset them there."""
    if not self._terms:
      return
    episode = self._episode
    if self._num_mean:
      # Means divide by the steps, the rest by one.
      steps = self._steps.clamp(min=1)[:, None]
      means = episode[:, : self._num_mean] / steps
      episode = torch.cat([means, episode[:, self._num_mean :]], dim=1)
    self._log.add(episode, mask & (self._steps > 0))
    where_(self._episode, mask, self._initial)
    fill_(self._steps, mask, 0)
    if self._substep_columns:
      fill_(self._substep_sums, mask, 0.0)
    super().reset(mask)

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return `Episode_Metrics/<term>`, means over ended episodes, and `Nonfinite/metrics/<term>`, values replaced by 0.

    A value is NaN if there was no such episode or no replaced value.
    """
    names, means = self._log.tensors()
    return [*names, *self._finite.names], torch.cat([means, nan_if_zero(self._finite.counts)])

  def clear_log(self) -> None:
    self._log.clear()
    self._finite.counts.zero_()

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    values = dict(zip((term.name for term in self._terms), self._finite.values[env_idx].tolist(), strict=True))
    return [(name, [values[name]]) for name in self._cfgs]

  def describe(self) -> str:
    rows = [(name, cfg.reduce, "every substep" if cfg.per_substep else "") for name, cfg in self._cfgs.items()]
    return table(("term", "reduce", "evaluated"), rows, title="Metrics")
