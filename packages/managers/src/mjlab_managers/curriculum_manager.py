"""Curricula: terms that change the task during training."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from mjlab_core import MjlabError

from mjlab_managers.env import ManagerEnv
from mjlab_managers.manager import ManagerBase
from mjlab_managers.terms.binding import Term, described
from mjlab_managers.terms.term import ManagerTermBaseCfg


@dataclass
class CurriculumTermCfg(ManagerTermBaseCfg):
  """Config of a curriculum: `func(env, mask, **params)` returns None, a 0-d tensor, or a dict of 0-d tensors to log.

  It is evaluated in every step before the reset, with the worlds to be reset in `mask`, bool (N,). The training
  progress is `env.common_step_counter`, on the device.
  """


class CurriculumManager(ManagerBase[CurriculumTermCfg]):
  """Manager that evaluates curricula and keeps the last state of each for the log.

  Args:
    cfgs: curricula by name.
    env: the environment.
    others: managers that curricula may change; they are restored after a trial call.
    problems: as for `ManagerBase`.
  """

  cfg_type = CurriculumTermCfg
  masked = True

  def __init__(
    self,
    cfgs: Mapping[str, CurriculumTermCfg | None],
    env: ManagerEnv,
    *,
    others: Iterable[ManagerBase[Any]] = (),
    problems: list[str] | None = None,
  ) -> None:
    self._others = tuple(others)
    self._last: dict[str, torch.Tensor] = {}
    super().__init__(cfgs, env, problems=problems)

  def _mistake(self, term: Term) -> str:
    # A term that takes indices may return anything when it first gets some; it runs on the host anyway.
    if not term.wants_ids:
      self._try(term, ~self._everywhere)
    return ""

  def _rehearse(self, term: Term) -> None:
    self._try(term, self._all_worlds(term))

  def _try(self, term: Term, worlds: torch.Tensor) -> None:
    """Call a term on trial, and make memory for its log entries."""
    undo = [manager.remember() for manager in self._others]
    try:
      entries = _entries(term, self._tried(term, worlds))
      if not term.wants_ids:
        self._reserve(entries)
    finally:
      for put_back in undo:
        put_back()

  def compute(self, mask: torch.Tensor) -> None:
    """Evaluate every term for the worlds about to be reset, `mask`, bool (N,)."""
    for term in self._terms.values():
      if term.wants_ids:
        self._with_ids(term, mask, lambda ids, term=term: self._keep(term, term(ids)))
      else:
        self._keep(term, term(mask))

  def _keep(self, term: Term, state: Any) -> None:
    entries = _entries(term, state)
    self._reserve(entries)
    for key, value in entries.items():
      self._last[key].copy_(value)

  def _reserve(self, keys: Iterable[str]) -> None:
    for key in keys:
      if key not in self._last:
        self._last[key] = torch.full((), torch.nan, dtype=torch.float64, device=self.device)

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return the last states as `Curriculum/<term>` or `Curriculum/<term>/<key>`."""
    if not self._last:
      return super().log_tensors()
    return list(self._last), torch.stack(list(self._last.values()))

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    del env_idx
    names, values = self.log_tensors()
    return [(name.removeprefix("Curriculum/"), [value]) for name, value in zip(names, values.tolist(), strict=True)]


def _entries(term: Term, state: Any) -> dict[str, torch.Tensor]:
  """Return log key and value of each part of a state. A term that takes indices may return numbers, too.

  Raises:
    MjlabError: the state is not None, a 0-d tensor or a dict of them.
  """
  if state is None:
    return {}
  entries = {}
  for key, value in state.items() if isinstance(state, Mapping) else [("", state)]:
    if term.wants_ids and isinstance(value, int | float):
      value = torch.tensor(float(value))
    if not isinstance(value, torch.Tensor) or value.dim() != 0:
      raise MjlabError(f"must return None, a 0-d tensor or a dict of them, returned {described(value)}.")
    entries[f"Curriculum/{term.name}/{key}" if key else f"Curriculum/{term.name}"] = value
  return entries
