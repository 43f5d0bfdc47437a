"""Curricula: terms that change the task as training goes on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch

from mjlab_managers.binding import Term
from mjlab_managers.env import ManagerEnv
from mjlab_managers.manager import ManagerBase, described
from mjlab_managers.table import table
from mjlab_managers.term import ManagerTermBaseCfg


@dataclass
class CurriculumTermCfg(ManagerTermBaseCfg):
  """A curriculum: `func(env, mask, **params)` returns None, a 0-d tensor, or a dict of 0-d tensors to log.

  It is evaluated every step, before anything is reset, with the worlds about to be reset in `mask`, bool (N,). What
  depends on training progress reads `env.common_step_counter`, on the device.
  """


class CurriculumManager(ManagerBase[CurriculumTermCfg]):
  """Evaluates curricula and keeps the last state of each for the log."""

  cfg_type = CurriculumTermCfg
  _constants = frozenset({"_last"})

  def __init__(self, cfgs: Mapping[str, CurriculumTermCfg | None], env: ManagerEnv) -> None:
    super().__init__(cfgs, env)
    self._terms: list[Term] = []
    self._names: list[str] = []
    nobody = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
    for name, cfg in self._cfgs.items():
      term = self._bind(name, cfg, masked=True)
      if term is None:
        continue
      self._terms.append(term)
      if not term.wants_ids:
        try:
          self._names += _entries(term, self._dry_run(term, nobody))
        except TypeError as error:
          self._problem(str(error), error)
    self._raise_problems()
    self._last = torch.full((len(self._names),), torch.nan, dtype=torch.float64, device=self.device)
    # Terms that take indices may return anything when they first meet a reset world; they run on the host anyway.
    self._from_ids: dict[str, torch.Tensor] = {}
    self._masks = {
      term.name: torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
      for term in self._terms
      if term.wants_ids
    }

  def compute(self, mask: torch.Tensor) -> None:
    """Evaluates every term; `mask` is bool (N,), the worlds about to be reset."""
    values: list[torch.Tensor] = []
    for term in self._terms:
      if term.wants_ids:
        self._compute_with_ids(term, mask)
      else:
        values += _entries(term, term(mask)).values()
    if values:
      self._last.copy_(torch.stack([value.double() for value in values]))

  def _compute_with_ids(self, term: Term, mask: torch.Tensor) -> None:
    kept = self._masks[term.name]
    kept.copy_(mask)

    def call() -> None:
      ids = kept.nonzero().flatten()
      if ids.numel() == 0:
        return
      state = term(ids)
      if isinstance(state, int | float):
        state = torch.tensor(float(state), device=self.device)
      for key, value in _entries(term, state).items():
        self._from_ids.setdefault(key, torch.zeros((), dtype=torch.float64, device=self.device)).copy_(value)

    self.env.run_eagerly(call, name=f"curriculum '{term.name}'")

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """`Curriculum/<term>` or `Curriculum/<term>/<key>`: the last state."""
    if not self._from_ids:
      return self._names, self._last.clone()
    return [*self._names, *self._from_ids], torch.cat([self._last, torch.stack(list(self._from_ids.values()))])

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    del env_idx
    names, values = self.log_tensors()
    return [(name.removeprefix("Curriculum/"), [value]) for name, value in zip(names, values.tolist(), strict=True)]

  def _watched_terms(self) -> list[Term]:
    return self._terms

  def describe(self) -> str:
    return table("Curricula", ("term",), [(term.name,) for term in self._terms])


def _entries(term: Term, state: Any) -> dict[str, torch.Tensor]:
  """Log key and value of each part of a state; TypeError if it is not one."""
  if state is None:
    return {}
  entries = {}
  for key, value in state.items() if isinstance(state, Mapping) else [("", state)]:
    if not isinstance(value, torch.Tensor) or value.dim() != 0:
      raise TypeError(
        f"term '{term.name}': must return None, a 0-d tensor or a dict of them, returned {described(value)}."
      )
    entries[f"Curriculum/{term.name}/{key}" if key else f"Curriculum/{term.name}"] = value
  return entries
