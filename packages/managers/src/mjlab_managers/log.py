"""Statistics that are collected on the device and read once per log interval."""

from __future__ import annotations

from collections.abc import Sequence

import torch


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
