"""Traffic between the ranks of a run: one reduction of gradients per update, and one of figures per iteration."""

import contextlib
from collections.abc import Generator, Mapping
from typing import Any, TypeAlias

import torch
from mjlab_core import printable
from mjlab_core.errors import MjlabError
from rsl_rl.models import MLPModel
from torch import distributed

from mjlab_rl.captured_ppo import CapturedPPO
from mjlab_rl.ranks import Ranks
from mjlab_rl.stop_signals import SIGNALS

Figures: TypeAlias = dict[str, dict[str, float]]


class RankAverages:
  """Averages over the ranks of a run, in place of rsl-rl's own traffic.

  The moments of observations, which rsl-rl sends for each normaliser, travel with the figures of the iteration. The KL
  divergence of a `CapturedPPO` travels with its gradients. Updates that rsl-rl does itself send both its way.

  Args:
    alg: Algorithm of rsl-rl.
    networks: Its networks.
    ranks: Place of this process.
    device: Device of the learner.
  """

  def __init__(self, alg: Any, networks: Mapping[str, MLPModel], ranks: Ranks, device: torch.device):
    self._ranks, self._device = ranks, device
    normalizers: list[Any] = [network.obs_normalizer for network in networks.values() if network.obs_normalization]
    self._normalizers = normalizers
    self._moments: dict[int, torch.Tensor] = {}
    self._names: list[tuple[str, str]] = []
    if ranks.world_size > 1 and isinstance(alg, CapturedPPO):
      alg.sum_over_ranks = self._sum

  @contextlib.contextmanager
  def replacing(self) -> Generator[None]:
    """Keep the normalisers' moments during an update instead of sending them; `reduce` must follow."""
    if self._ranks.world_size == 1:
      yield
      return
    for index, normalizer in enumerate(self._normalizers):
      normalizer.update = lambda seen, index=index: self._note(index, seen)
    try:
      yield
    finally:
      # The methods of the classes are in effect again.
      for normalizer in self._normalizers:
        del normalizer.update

  def reduce(self, own: Mapping[str, Mapping[str, float]], signal: str | None) -> tuple[Figures, str | None]:
    """Update the normalisers with the observations of all ranks, and average the figures of an iteration.

    Args:
      own: Figures of this process by kind and name; other processes may have other names.
      signal: Signal that this process received.

    Returns:
      The mean of each figure over the processes that have it, and a signal that one of them received.
    """
    if self._ranks.world_size == 1:
      return {kind: dict(figures) for kind, figures in own.items()}, signal
    mine = {(kind, name): value for kind, figures in own.items() for name, value in figures.items()}
    moments = [self._moments[index].flatten() for index in sorted(self._moments)]
    while True:
      is_new = not mine.keys() <= set(self._names)
      columns = [(mine[name], 1.0) if name in mine else (0.0, 0.0) for name in self._names]
      head = [
        float(is_new),
        *(float(name == signal) for name in SIGNALS),
        *(value for pair in columns for value in pair),
      ]
      numbers = torch.cat((torch.tensor(head, dtype=torch.float64, device=self._device), *moments))
      self._sum(numbers)
      values = numbers[: len(head)].tolist()
      if not values[0]:
        break
      # Once, in the first iteration and when a log has a new name.
      self._names = list(dict.fromkeys(name for names in self._ranks.gather(list(mine)) for name in names))
    start = len(head)
    for index in sorted(self._moments):
      shape = self._moments.pop(index).shape
      _learn(self._normalizers[index], numbers[start : start + shape.numel()].view(shape))
      start += shape.numel()
    received, figures = values[1 : 1 + len(SIGNALS)], values[1 + len(SIGNALS) :]
    means: Figures = {kind: {} for kind in own}
    for (kind, name), total, count in zip(self._names, figures[::2], figures[1::2], strict=True):
      if count:
        means[kind][name] = total / count
    return means, next((name for name, count in zip(SIGNALS, received, strict=True) if count), None)

  def _sum(self, numbers: torch.Tensor) -> None:
    """Sum numbers over the ranks in place."""
    try:
      distributed.all_reduce(numbers)
    except RuntimeError as error:
      reason = printable((str(error).splitlines() or [""])[0], 200)
      raise MjlabError(f"rank {self._ranks.rank}: another process of the run has ended or hangs ({reason})") from error

  def _note(self, index: int, seen: torch.Tensor) -> None:
    """Keep the moments of this rank's observations about the mean so far, (3, dim), for `reduce`."""
    normalizer = self._normalizers[index]
    if not normalizer.training or (normalizer.until is not None and int(normalizer.count) >= normalizer.until):
      return
    offset = seen - dict(normalizer.named_buffers())["_mean"]
    total = offset.sum(0, dtype=torch.float64)
    square = offset.square_().sum(0, dtype=torch.float64)
    self._moments[index] = torch.stack((torch.full_like(total, len(seen)), total, square))


def _learn(normalizer: Any, moments: torch.Tensor) -> None:
  """Update a normaliser of rsl-rl with moments of new observations about its mean, (3, dim)."""
  mean, variance, std = (dict(normalizer.named_buffers())[name] for name in ("_mean", "_var", "_std"))
  count = moments[:1]
  offset = moments[1:2] / count
  normalizer.count += count[0, 0].to(normalizer.count.dtype)
  rate = count / normalizer.count
  change = rate * offset
  mean += change.to(mean.dtype)
  variance += (rate * (moments[2:3] / count - offset * change - variance)).to(variance.dtype)
  std.copy_(variance.sqrt())
