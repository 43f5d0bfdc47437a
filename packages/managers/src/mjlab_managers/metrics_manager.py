"""Metrics: numbers about an episode that are logged and not optimised."""

from __future__ import annotations

import itertools
from dataclasses import KW_ONLY, dataclass
from typing import Literal, get_args

import torch
from mjlab_core import fill_, where_

from mjlab_managers.term import ManagerTermBaseCfg
from mjlab_managers.vector_manager import VectorManager

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
    ranks = {name: _REDUCTIONS.index(self._cfgs[name].reduce) for name in self._terms}
    self._names = sorted(ranks, key=lambda name: ranks[name])
    counts = [list(ranks.values()).count(rank) for rank in range(len(_REDUCTIONS))]
    num_mean, self._num_added, self._max_start, _ = itertools.accumulate(counts)
    self._is_mean = torch.arange(len(self._names), device=self.device) < num_mean
    self._substep_columns = [i for i, name in enumerate(self._names) if self._cfgs[name].per_substep]
    self._substeps = round(self.env.step_dt / self.env.physics_dt)

    self._initial = torch.zeros(1, len(self._names), device=self.device)
    self._initial[:, self._max_start :] = -torch.inf
    self._episode = self.state((len(self._names),), fill=self._initial)
    self._steps = self.state(dtype=torch.int64)
    self._substep_sums = self.state((len(self._substep_columns),))
    self._lay_out("metrics")
    self._shown = self._values

  def compute_substep(self) -> None:
    """Evaluate the per-substep metrics. Call it after every physics substep."""
    if self._substep_columns:
      values = [self._terms[self._names[column]]() for column in self._substep_columns]
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
    others = [i for i in range(len(self._names)) if i not in values]
    values |= dict(zip(others, self.evaluate([self._terms[self._names[i]] for i in others]), strict=True))
    now = self._put([values[i] for i in range(len(self._names))])
    added, top = self._num_added, self._max_start
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
    return self._values[:, self._column(name)]

  def reset(self, mask: torch.Tensor) -> None:
    """Log the metrics of the worlds in `mask`, bool (N,), that had a step, and reset them there."""
    if not self._terms:
      return
    divisors = torch.where(self._is_mean, self._steps[:, None], 1)
    self._log.add(self._episode / divisors, mask & (self._steps > 0))
    where_(self._episode, mask, self._initial)
    fill_(self._steps, mask, 0)
    if self._substep_columns:
      fill_(self._substep_sums, mask, 0.0)
    super().reset(mask)

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return `Episode_Metrics/<term>`, means over ended episodes, and `Nonfinite/metrics/<term>`, values replaced by 0.

    A value is NaN if there was no such episode or no replaced value.
    """
    return super().log_tensors()
