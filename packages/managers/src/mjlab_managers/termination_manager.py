"""Terminations: conditions that end an episode."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import torch

from mjlab_managers.terms.term import ManagerTermBaseCfg
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
    self._ended = self.state((2,), dtype=torch.bool)
    self.terminated = self._ended[:, 0]
    """Worlds that ended for another reason than time in the last `compute`, bool (N,)."""
    self.time_outs = self._ended[:, 1]
    """Worlds that ran out of time in the last `compute`, bool (N,)."""
    self.dones = self.state(dtype=torch.bool)
    """Worlds that ended in the last `compute`, bool (N,)."""
    self._masks = self._shown = self.state((len(self._terms),), dtype=torch.bool)
    self._counts = torch.zeros(len(self._terms), dtype=torch.int64, device=self.device)
    # Terms of each kind: terminations and time-outs.
    self._kinds = torch.zeros(2, len(self._terms), dtype=torch.bool, device=self.device)
    self._time_outs: list[bool] = []
    self.sync()

  def get_term(self, name: str) -> torch.Tensor:
    """Return the value of a term in the last `compute`, bool (N,)."""
    return self._masks[:, self._column(name)]

  @property
  def step_terms(self) -> tuple[list[str], torch.Tensor]:
    """Names of the terms, and their values in the last `compute`, bool (N, terms), always the same memory."""
    return self.active_terms, self._masks

  def compute(self) -> torch.Tensor:
    """Evaluate the step and return `dones`, bool (N,), always the same memory."""
    if not self._terms:
      return self.dones
    torch.stack(self.evaluate(list(self._terms.values())), dim=1, out=self._masks)
    torch.any(self._masks[:, None] & self._kinds, dim=2, out=self._ended)
    torch.any(self._ended, dim=1, out=self.dones)
    self._counts.add_(self._masks.sum(0))
    return self.dones

  def sync(self) -> None:
    """Read changed `time_out` flags from the configs, on the host before each step."""
    time_outs = [bool(cfg.time_out) for cfg in self._cfgs.values()]
    if time_outs != self._time_outs:
      self._time_outs = time_outs
      self._kinds[1] = torch.tensor(time_outs, device=self.device)
      torch.logical_not(self._kinds[1], out=self._kinds[0])

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return `Episode_Termination/<term>`, episodes that the term ended since `clear_log`; NaN if no episode ended."""
    counts = self._counts.double()
    names = [f"Episode_Termination/{name}" for name in self._terms]
    return names, counts.masked_fill(counts.sum() == 0, torch.nan)

  def clear_log(self) -> None:
    self._counts.zero_()
