"""Metrics: numbers about an episode that are logged and not optimised."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Literal

import torch
from mjlab_core import fill_, where_

from mjlab_managers.terms.binding import call_terms
from mjlab_managers.terms.term import ManagerTermBaseCfg
from mjlab_managers.vector_manager import VectorManager

Reduction = Literal["mean", "sum", "last", "max"]


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
    cfgs = list(self._cfgs.values())

    def of_kind(kind: Reduction) -> torch.Tensor:
      return torch.tensor([[cfg.reduce == kind for cfg in cfgs]], dtype=torch.bool, device=self.device)

    self._is_mean, self._is_max = of_kind("mean"), of_kind("max")
    self._has_max = any(cfg.reduce == "max" for cfg in cfgs)
    # Factor of the values of the steps before.
    self._keeps = (~of_kind("last")).float()
    self._by_substep = [term for name, term in self._terms.items() if self._cfgs[name].per_substep]
    self._by_step = [term for term in self._terms.values() if term not in self._by_substep]
    self._substeps = round(self.env.step_dt / self.env.physics_dt)

    self._initial = torch.where(self._is_max, -torch.inf, 0.0)
    self._episode = self.state((len(cfgs),), fill=self._initial)
    self._steps = self.state(dtype=torch.int64)
    self._substep_sums = self.state((len(self._by_substep),))
    self._lay_out("metrics")
    self._shown = self._values

  def compute_substep(self) -> None:
    """Evaluate the per-substep metrics. Call it after every physics substep."""
    if self._by_substep:
      self._substep_sums.add_(torch.stack(call_terms(self._by_substep), dim=1))

  def compute(self) -> None:
    """Evaluate the other metrics and add the step to the episode."""
    if not self._terms:
      return
    means = (self._substep_sums / self._substeps).unbind(1)
    self._substep_sums.zero_()
    values = dict(zip(self._by_substep, means, strict=True))
    values |= dict(zip(self._by_step, self.evaluate(self._by_step), strict=True))
    now = self._put([values[term] for term in self._terms.values()])
    highest = torch.maximum(self._episode, now) if self._has_max else None
    torch.addcmul(now, self._episode, self._keeps, out=self._episode)
    if highest is not None:
      torch.where(self._is_max, highest, self._episode, out=self._episode)
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
    fill_(self._substep_sums, mask, 0.0)
    super().reset(mask)

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return `Episode_Metrics/<term>`, means over ended episodes, and `Nonfinite/metrics/<term>`, values replaced by 0.

    A value is NaN if there was no such episode or no replaced value.
    """
    return super().log_tensors()
