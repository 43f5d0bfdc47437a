"""Terminations: conditions that end an episode."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import torch

from mjlab_managers.term import ManagerTermBaseCfg
from mjlab_managers.vector_manager import VectorManager


@dataclass
class TerminationTermCfg(ManagerTermBaseCfg):
  """Config of a termination: `func(env, **params)` returns bool (N,)."""

  _: KW_ONLY
  time_out: bool = False
  """True: the episode is truncated, although the task could continue; False: the episode is terminated."""


class TerminationManager(VectorManager[TerminationTermCfg]):
  """Manager that evaluates all terminations. A world may be terminated and timed out in the same step."""

  cfg_type = TerminationTermCfg
  live_fields = frozenset({"time_out"})
  dtype_name = "bool"

  def _make(self) -> None:
    self.terminated = self.state(dtype=torch.bool)
    """Worlds that ended for another reason than time in the last `compute`, bool (N,)."""
    self.time_outs = self.state(dtype=torch.bool)
    """Worlds that ran out of time in the last `compute`, bool (N,)."""
    self.dones = self.state(dtype=torch.bool)
    """Worlds that ended in the last `compute`, bool (N,)."""
    self._masks = self.state((len(self._terms),), dtype=torch.bool)
    self._shown = self._masks
    self._counts = torch.zeros(len(self._terms), dtype=torch.int64, device=self.device)
    self._order()

  def _order(self) -> None:
    # Columns hold terminations first, so that both unions are over a slice.
    self._kinds = self._read_kinds()
    self._names = sorted(self._kinds, key=lambda name: self._kinds[name])
    self._num_terminations = list(self._kinds.values()).count(False)

  def _read_kinds(self) -> dict[str, bool]:
    return {name: bool(self._cfgs[name].time_out) for name in self._terms}

  def get_term(self, name: str) -> torch.Tensor:
    """Return the value of a term in the last `compute`, bool (N,)."""
    return self._masks[:, self._column(name)]

  @property
  def step_terms(self) -> tuple[list[str], torch.Tensor]:
    """Names of the terms, and their values in the last `compute`, bool (N, terms), always the same memory."""
    return self._names, self._masks

  def compute(self) -> torch.Tensor:
    """Evaluate the step and return `dones`, bool (N,), always the same memory."""
    if not self._terms:
      return self.dones
    torch.stack(self.evaluate([self._terms[name] for name in self._names]), dim=1, out=self._masks)
    torch.any(self._masks[:, : self._num_terminations], dim=1, out=self.terminated)
    torch.any(self._masks[:, self._num_terminations :], dim=1, out=self.time_outs)
    torch.logical_or(self.terminated, self.time_outs, out=self.dones)
    self._counts.add_(self._masks.sum(0))
    return self.dones

  def sync(self) -> None:
    """Read changed `time_out` flags from the configs, on the host before each step."""
    if self._read_kinds() != self._kinds:
      self._order()
      self._counts.zero_()
      self.env.request_recapture(f"{self.label}: time_out of a term changed")

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return `Episode_Termination/<term>`, episodes that the term ended since `clear_log`; NaN if no episode ended."""
    counts = self._counts.double()
    names = [f"Episode_Termination/{name}" for name in self._names]
    return names, counts.masked_fill(counts.sum() == 0, torch.nan)

  def clear_log(self) -> None:
    self._counts.zero_()
