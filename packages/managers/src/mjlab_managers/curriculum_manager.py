"""Curricula: terms that change the task during training."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from mjlab_core import MjlabError
from mjlab_core.tables import table

from mjlab_managers.binding import Term, described
from mjlab_managers.env import ManagerEnv
from mjlab_managers.manager import ManagerBase
from mjlab_managers.term import ManagerTermBaseCfg


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
    super().__init__(cfgs, env, problems=problems)

  def _make(self) -> None:
    self._no_world = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
    self._terms: list[Term] = []
    self._names: list[str] = []
    for name, cfg in list(self._cfgs.items()):
      term = self._bind(name, cfg)
      # A term that takes indices may return anything when it first gets some; it runs on the host anyway.
      entries = {} if term is None or term.wants_ids else self._try(term, self._no_world)
      if term is None or entries is None:
        self._drop(name)
        continue
      self._terms.append(term)
      self._names += entries
    self._raise_problems()
    self._last = torch.full((len(self._names),), torch.nan, dtype=torch.float64, device=self.device)
    self._from_ids: dict[str, torch.Tensor] = {}

  def rehearse(self) -> None:
    for term in self._terms:
      worlds = torch.arange(self.num_envs, device=self.device)
      self._try(term, worlds if term.wants_ids else worlds >= 0)
    self._raise_problems()

  def _check_again(self, term: Term) -> bool:
    return term.wants_ids or self._try(term, self._no_world) is not None

  def _try(self, term: Term, worlds: torch.Tensor) -> dict[str, torch.Tensor] | None:
    """Return the log entries of a trial call, or None with the mistake noted."""
    undo = [manager.remember() for manager in self._others]
    with self._trial(term.name, term.func) as trial:
      value = term.try_call(worlds, rebuilt=trial.rebuilt)
      trial.value = _entries(term, _as_tensor(value, self.device) if term.wants_ids else value)
    for put_back in undo:
      put_back()
    return None if trial.failed else trial.value

  def compute(self, mask: torch.Tensor) -> None:
    """Evaluate every term for the worlds about to be reset, `mask`, bool (N,)."""
    values: list[torch.Tensor] = []
    for term in self._terms:
      if term.wants_ids:
        self._with_ids(term.name, mask, lambda ids, term=term: self._compute_with_ids(term, ids))
      else:
        values += _entries(term, term(mask)).values()
    if values:
      self._last.copy_(torch.stack([value.double() for value in values]))

  def _compute_with_ids(self, term: Term, ids: torch.Tensor) -> None:
    for key, value in _entries(term, _as_tensor(term(ids), self.device)).items():
      self._from_ids.setdefault(key, torch.zeros((), dtype=torch.float64, device=self.device)).copy_(value)

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return the last states as `Curriculum/<term>` or `Curriculum/<term>/<key>`."""
    if not self._from_ids:
      return self._names, self._last.clone()
    return [*self._names, *self._from_ids], torch.cat([self._last, torch.stack(list(self._from_ids.values()))])

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    del env_idx
    names, values = self.log_tensors()
    return [(name.removeprefix("Curriculum/"), [value]) for name, value in zip(names, values.tolist(), strict=True)]

  def describe(self) -> str:
    return table(("term",), [(term.name,) for term in self._terms], title="Curricula")


def _as_tensor(state: Any, device: torch.device) -> Any:
  return torch.tensor(float(state), device=device) if isinstance(state, int | float) else state


def _entries(term: Term, state: Any) -> dict[str, torch.Tensor]:
  """Return log key and value of each part of a state.

  Raises:
    MjlabError: the state is not None, a 0-d tensor or a dict of them.
  """
  if state is None:
    return {}
  entries = {}
  for key, value in state.items() if isinstance(state, Mapping) else [("", state)]:
    if not isinstance(value, torch.Tensor) or value.dim() != 0:
      raise MjlabError(f"must return None, a 0-d tensor or a dict of them, returned {described(value)}.")
    entries[f"Curriculum/{term.name}/{key}" if key else f"Curriculum/{term.name}"] = value
  return entries
