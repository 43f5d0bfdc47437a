"""Averages over the ranks of a run, in one message per iteration."""

import functools
from collections.abc import Mapping
from typing import Any, TypeAlias

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict

from mjlab_rl.models.networks import merge_moments
from mjlab_rl.processes.ranks import Ranks
from mjlab_rl.processes.stop_signals import SIGNALS

Figures: TypeAlias = dict[str, float]
"""Figures of an iteration by tag."""


class RankAverages:
  """Averages of figures and of the moments of observations, which rsl-rl would send for each normaliser.

  With several ranks, `update_normalization` of the networks keeps the moments for `reduce`, and does nothing else.

  Args:
    networks: Networks of the learner.
    ranks: Place of this process.
    device: Device of the learner.
  """

  def __init__(self, networks: Mapping[str, Any], ranks: Ranks, device: torch.device):
    self._ranks, self._device = ranks, device
    self._moments: dict[Any, torch.Tensor] = {}
    self._tags: list[str] = []
    if ranks.world_size > 1:
      for network in networks.values():
        if network.obs_normalization:
          network.update_normalization = functools.partial(self._note, network)

  def reduce(self, own: Figures, signal: str | None) -> tuple[Figures, str | None]:
    """Update the normalisers with the observations of all ranks, and average the figures of an iteration.

    Args:
      own: Figures of this process; other processes may have other tags.
      signal: Signal that this process received.

    Returns:
      The mean of each figure over the processes that have it, and a signal that one of them received.
    """
    if self._ranks.world_size == 1:
      return own, signal
    if signal is not None:
      own = own | {signal: 1.0}
    moments = [part.flatten() for part in self._moments.values()]
    while True:
      is_new = not own.keys() <= set(self._tags)
      totals = [own.get(tag, 0.0) for tag in self._tags]
      counts = [float(tag in own) for tag in self._tags]
      head = torch.tensor([is_new, *totals, *counts], dtype=torch.float64, device=self._device)
      summed = torch.cat((head, *moments))
      self._ranks.sum(summed)
      is_incomplete, *figures = summed[: len(head)].tolist()
      if not is_incomplete:
        break
      # Once, in the first iteration and when a log has a new tag.
      self._tags = list(dict.fromkeys(tag for tags in self._ranks.gather(list(own)) for tag in tags))
    parts = summed[len(head) :].split([len(part) for part in moments])
    for normalizer, part in zip(self._moments, parts, strict=True):
      times, total, square = part.view(3, 1, -1)
      delta = total / times
      merge_moments(normalizer, times[0, 0].long(), delta, square / times - delta.square())
    self._moments.clear()
    count = len(self._tags)
    found = zip(self._tags, figures[:count], figures[count:], strict=True)
    means = {tag: total / times for tag, total, times in found if times}
    return means, next((name for name in SIGNALS if means.pop(name, None)), None)

  def forget(self, network: MLPModel) -> None:
    """Leave the normaliser of a network as it is in the next `reduce`."""
    self._moments.pop(network.obs_normalizer, None)

  def _note(self, network: MLPModel, obs: TensorDict) -> None:
    """Keep the moments of this rank's observations about the mean so far, (3, dim), for `reduce`."""
    normalizer = network.obs_normalizer
    seen = torch.cat([obs[group] for group in network.obs_groups], -1)
    offset = seen - dict(normalizer.named_buffers())["_mean"]
    total = offset.sum(0, dtype=torch.float64)
    square = offset.square_().sum(0, dtype=torch.float64)
    self._moments[normalizer] = torch.stack((torch.full_like(total, len(seen)), total, square))
