"""Base of managers whose terms return one number per world, and their statistics over episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch

from mjlab_managers.manager import CfgT, ManagerBase
from mjlab_managers.terms.binding import Term


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


def nan_if_zero(counts: torch.Tensor) -> torch.Tensor:
  """Return counts for a log, float64, in which NaN stands for none."""
  return counts.double().masked_fill(counts == 0, torch.nan)


class VectorManager(ManagerBase[CfgT]):
  """Base of managers whose terms return one number per world. Every term is called on trial at build."""

  dtype_name: ClassVar[str] = "float"
  """Kind of number that terms return, "float" or "bool"."""

  def _mistake(self, term: Term) -> str:
    def fits(value: torch.Tensor) -> bool:
      is_kind = value.is_floating_point() if self.dtype_name == "float" else value.dtype is torch.bool
      return is_kind and value.shape == (self.num_envs,)

    return self._misfit(self._tried(term), f"{self.dtype_name} ({self.num_envs},)", fits)

  _shown: torch.Tensor
  """Values of the terms in the last step, (N, K)."""

  def _column(self, name: str) -> int:
    self.term(name)
    return list(self._terms).index(name)

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    values = self._shown[env_idx].tolist()
    return [(name, [float(value)]) for name, value in zip(self._terms, values, strict=True)]

  def _lay_out(self, kind: str) -> None:
    """Make memory and logs for the values of the terms, side by side."""
    names = list(self._terms)
    self._raw = torch.zeros(self.num_envs, len(names), device=self.device)
    self._values = torch.zeros_like(self._raw)
    self._nonfinite = torch.zeros(len(names), dtype=torch.int64, device=self.device)
    self._nonfinite_keys = [f"Nonfinite/{kind}/{name}" for name in names]
    self._log = LogBuffer([f"Episode_{kind.capitalize()}/{name}" for name in names], self.device)

  def _put(self, columns: Sequence[torch.Tensor]) -> torch.Tensor:
    """Return the values of all terms, (N,) each, as (N, K). NaN and infinite ones become 0 and are counted."""
    torch.stack(list(columns), dim=1, out=self._raw)
    torch.nan_to_num(self._raw, nan=0.0, posinf=0.0, neginf=0.0, out=self._values)
    self._nonfinite.add_((self._raw != self._values).sum(0))
    return self._values

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    names, means = self._log.tensors()
    return [*names, *self._nonfinite_keys], torch.cat([means, nan_if_zero(self._nonfinite)])

  def clear_log(self) -> None:
    self._log.clear()
    self._nonfinite.zero_()
