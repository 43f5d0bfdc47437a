"""Traffic between the ranks of a run: one reduction of gradients per update, and one of figures per iteration."""

import contextlib
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
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

# Limits and factor of rsl-rl's adaptive learning rate.
_RATES, _FACTOR = (1e-5, 1e-2), 1.5


class RankAverages:
  """Averages over the ranks of a run, in place of rsl-rl's own traffic.

  rsl-rl sends gradients, the KL divergence, the learning rate and the moments of each normaliser one by one, which are
  several messages per mini-batch. Here the KL divergence travels with the gradients, and the moments of the
  observations with the figures of the iteration. The results are the same.

  Args:
    alg: Algorithm of rsl-rl.
    networks: Its networks.
    ranks: Place of this process.
    device: Device of the learner.
  """

  def __init__(self, alg: Any, networks: Mapping[str, MLPModel], ranks: Ranks, device: torch.device):
    self._alg, self._ranks, self._device = alg, ranks, device
    normalizers: list[Any] = [network.obs_normalizer for network in networks.values() if network.obs_normalization]
    self._normalizers = normalizers
    self._moments: dict[int, torch.Tensor] = {}
    self._names: list[tuple[str, str]] = []
    self._batch: Any = None
    if ranks.world_size > 1 and isinstance(alg, CapturedPPO):
      alg.sum_over_ranks = self._sum

  @contextlib.contextmanager
  def replacing(self) -> Generator[None]:
    """Replace rsl-rl's traffic during an update; `reduce` must follow."""
    if self._ranks.world_size == 1:
      yield
      return
    is_rsl_rl = not (isinstance(self._alg, CapturedPPO) and self._alg.is_covered)
    alg: Any = self._alg
    storage = alg.storage
    is_adaptive = is_rsl_rl and getattr(alg, "schedule", None) == "adaptive" and alg.desired_kl is not None
    if is_rsl_rl:
      alg.reduce_parameters = self._reduce_adaptively if is_adaptive else self._reduce_gradients
    if is_adaptive:
      alg.schedule = "fixed"  # _reduce_adaptively adapts.
      for name in ("mini_batch_generator", "recurrent_mini_batch_generator"):
        setattr(storage, name, self._remembering(getattr(storage, name)))
    for index, normalizer in enumerate(self._normalizers):
      normalizer.update = lambda seen, index=index: self._note(index, seen)
    try:
      yield
    finally:
      # The methods of the classes are in effect again.
      for normalizer in self._normalizers:
        del normalizer.update
      if is_rsl_rl:
        del alg.reduce_parameters
      if is_adaptive:
        alg.schedule, self._batch = "adaptive", None
        del storage.mini_batch_generator, storage.recurrent_mini_batch_generator

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
    """Sum numbers over the ranks in place.

    Raises:
      MjlabError: A process has ended or hangs.
    """
    try:
      distributed.all_reduce(numbers)
    except RuntimeError as error:
      reason = printable((str(error).splitlines() or [""])[0], 200)
      raise MjlabError(f"rank {self._ranks.rank}: another process of the run has ended or hangs ({reason})") from error

  def _remembering(self, generate: Callable[..., Iterable[Any]]) -> Callable[..., Iterator[Any]]:
    def batches(*args: Any) -> Iterator[Any]:
      for batch in generate(*args):
        self._batch = batch
        yield batch

    return batches

  def _reduce_gradients(self, *others: torch.Tensor) -> torch.Tensor:
    """Average all gradients, and other numbers with them, in one buffer; return the buffer."""
    optimizers = [self._alg.optimizer, *([self._alg.rnd.optimizer] if getattr(self._alg, "rnd", None) else [])]
    groups = [group for optimizer in optimizers for group in optimizer.param_groups]
    grads = [parameter.grad for group in groups for parameter in group["params"] if parameter.grad is not None]
    flat = torch.cat([part.reshape(-1) for part in (*grads, *others)])
    self._sum(flat)
    flat /= self._ranks.world_size
    parts = flat.split([grad.numel() for grad in grads] + [flat.numel() - sum(grad.numel() for grad in grads)])
    for grad, part in zip(grads, parts, strict=False):
      grad.copy_(part.view_as(grad))
    return flat

  def _reduce_adaptively(self) -> None:
    """Average the gradients, and adapt the learning rate by the averaged KL divergence, as rsl-rl does."""
    alg = self._alg
    old = self._batch.old_distribution_params
    with torch.no_grad():
      new = tuple(
        part[: len(was)].detach() for part, was in zip(alg.actor.output_distribution_params, old, strict=True)
      )
      kl = alg.actor.get_kl_divergence(old, new).mean()
    kl_mean = float(self._reduce_gradients(kl)[-1])
    if kl_mean > 2.0 * alg.desired_kl:
      alg.learning_rate = max(_RATES[0], alg.learning_rate / _FACTOR)
    elif 0.0 < kl_mean < 0.5 * alg.desired_kl:
      alg.learning_rate = min(_RATES[1], alg.learning_rate * _FACTOR)
    for group in alg.optimizer.param_groups:
      group["lr"] = alg.learning_rate

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
