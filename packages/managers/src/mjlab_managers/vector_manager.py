"""Base of managers whose terms return one number per world, and their statistics over episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch

from mjlab_managers.binding import Term
from mjlab_managers.manager import CfgT, ManagerBase
from mjlab_managers.term import ManagerTermBase, ManagerTermBaseCfg


class LogBuffer:
  """Means over pairs of world and time, one for each name.

  Args:
    names: K log keys.
    device: device of the sums.
  """

  def __init__(self, names: Sequence[str], device: torch.device | str) -> None:
    self.names = list(names)
    self._sums = torch.zeros(len(self.names), dtype=torch.float64, device=device)
    self._count = torch.zeros((), dtype=torch.int64, device=device)

  def add(self, values: torch.Tensor, mask: torch.Tensor) -> None:
    """Add the rows of `values`, (N, K), of the worlds in `mask`, bool (N,)."""
    if not self.names:
      return
    self._sums.add_(values.masked_fill(~mask[:, None], 0.0).sum(0))
    self._count.add_(mask.sum())

  def tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return names and means, float64 (K,), NaN if nothing was added since `clear`."""
    return self.names, self._sums / self._count

  def clear(self) -> None:
    """Begin a new interval."""
    self._sums.zero_()
    self._count.zero_()


class FiniteValues:
  """Values of terms side by side, in fixed memory; NaN and infinite ones become 0 and are counted.

  Args:
    names: names of the terms.
    kind: what they are, for log keys.
    num_envs: number of worlds.
    device: device of the values.
  """

  def __init__(self, names: Sequence[str], kind: str, num_envs: int, device: torch.device | str) -> None:
    self.names = [f"Nonfinite/{kind}/{name}" for name in names]
    self._raw = torch.zeros(num_envs, len(names), device=device)
    self.values = torch.zeros_like(self._raw)
    """Values of the last `put`, (N, K)."""
    self.counts = torch.zeros(len(names), dtype=torch.int64, device=device)
    """Values that were replaced, int64 (K,)."""

  def put(self, columns: Sequence[torch.Tensor]) -> None:
    """Take the values of all terms, (N,) each."""
    torch.stack(list(columns), dim=1, out=self._raw)
    torch.nan_to_num(self._raw, nan=0.0, posinf=0.0, neginf=0.0, out=self.values)
    self.counts.add_((self._raw != self.values).sum(0))


def nan_if_zero(counts: torch.Tensor) -> torch.Tensor:
  """Return counts for a log, float64, in which NaN stands for none."""
  return counts.double().masked_fill(counts == 0, torch.nan)


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

    def fits(value: torch.Tensor) -> bool:
      is_kind = value.is_floating_point() if self.dtype_name == "float" else value.dtype is torch.bool
      return is_kind and value.shape == (self.num_envs,)

    return not trial.failed and self._check_tensor(
      term.name, trial.value, f"{self.dtype_name} ({self.num_envs},)", fits
    )
