"""Base of managers whose terms return one number per world: rewards, terminations, metrics."""

from __future__ import annotations

from typing import ClassVar

import torch

from mjlab_managers.binding import Term
from mjlab_managers.manager import CfgT, ManagerBase, described, is_float
from mjlab_managers.term import ManagerTermBase, ManagerTermBaseCfg


class VectorManager(ManagerBase[CfgT]):
  """Base of managers whose terms return one number per world.

  Every term is called on trial at build. A term with a mistake is reported and left out.
  """

  dtype_name: ClassVar[str] = "float"
  """Kind of number that terms return, "float" or "bool"."""

  def _bind_vectors(self) -> list[Term]:
    """Return the terms without mistakes."""
    terms: list[Term] = []
    for name, cfg in list(self._cfgs.items()):
      assert isinstance(cfg, ManagerTermBaseCfg)
      before = len(self._problems)
      term = self._bind(name, cfg)
      if term is not None and self._check_again(term) and len(self._problems) == before:
        terms.append(term)
      else:
        self._drop(name)
    return terms

  def _check_again(self, term: Term) -> bool:
    with self._trial(term.name, term.func) as trial:
      trial.value = term.try_call(rebuilt=trial.rebuilt)
      if isinstance(term.func, ManagerTermBase):
        term.func.reset(torch.ones(self.num_envs, dtype=torch.bool, device=self.device))
    if trial.failed:
      return False
    what = f"{self.dtype_name} ({self.num_envs},)"
    fits = is_float if self.dtype_name == "float" else lambda dtype: dtype is torch.bool
    value = trial.value
    if not self._check_tensor(term.name, value, what, fits):
      return False
    if value.shape != (self.num_envs,):
      self._problem(f"term '{term.name}': must return {what}, returned {described(value)}.")
      return False
    return True
