"""Returns and noise of off-policy learning: projection of distributions, scale of returns, repeated noise."""

import torch
from torch import distributed, nn

from mjlab_rl.offpolicy.networks import Normalizer


def project(probabilities: torch.Tensor, values: torch.Tensor, support: torch.Tensor) -> torch.Tensor:
  """Return a distribution over `support` with the expectation of one over other values.

  Each value's probability is divided between its two neighbours in the support; values outside go to the nearest end
  (C51, Bellemare et al. 2017, arXiv:1707.06887, algorithm 1).

  Args:
    probabilities: Probabilities of the values, (..., num_atoms).
    values: The values, of the same shape.
    support: Equally spaced values, (num_atoms,).
  """
  last = support.numel() - 1
  place = ((values - support[0]) / (support[-1] - support[0]) * last).clamp(0, last)
  # The last value has no upper neighbour; it is the lower one's with a share of 1.
  lower = place.floor().clamp(max=last - 1)
  share, index = place - lower, lower.long()
  projected = torch.zeros_like(probabilities)
  projected.scatter_add_(-1, index, probabilities * (1.0 - share))
  return projected.scatter_add_(-1, index + 1, probabilities * share)


class ReturnScale(nn.Module):
  """Divisor of rewards that brings returns to the support of the critic (SimbaV2, arXiv:2502.15280).

  The divisor is the standard deviation of the running discounted return, and at least its largest value so far over
  `value_limit`.

  Args:
    num_envs: Number of worlds.
    gamma: Discount of a step.
    value_limit: End of the support.
  """

  def __init__(self, num_envs: int, gamma: float, value_limit: float) -> None:
    super().__init__()
    self.statistics = Normalizer(1)
    self.running: torch.Tensor
    self.largest: torch.Tensor
    self.register_buffer("running", torch.zeros(num_envs), persistent=False)
    self.register_buffer("largest", torch.zeros(()))
    self._gamma, self._limit = gamma, value_limit

  def add(self, rewards: torch.Tensor, dones: torch.Tensor) -> None:
    """Account for one step, (num_envs,) each; the return of an ended episode begins at 0 again."""
    self.running.mul_(self._gamma).add_(rewards)
    self.statistics.update(self.running[:, None])
    torch.maximum(self.largest, self.running.abs().max(), out=self.largest)
    if distributed.is_initialized():
      distributed.all_reduce(self.largest, op=distributed.ReduceOp.MAX)
    self.running.masked_fill_(dones > 0, 0.0)

  def divisor(self) -> torch.Tensor:
    """Return the divisor, ()."""
    return torch.maximum(self.statistics.std.view(()), self.largest / self._limit).clamp(min=1e-4)


class RepeatedNoise:
  """Standard normal noise of each world that stays for a random number of steps (FlashSAC, arXiv:2604.04539).

  Numbers k up to `most` have probabilities proportional to 1 / k^2.

  Args:
    num_envs: Number of worlds.
    num_actions: Number of actions.
    most: Largest number of steps; 1: new noise in every step.
    device: Device of the noise.
  """

  def __init__(self, num_envs: int, num_actions: int, most: int, device: torch.device | str) -> None:
    weights = 1.0 / torch.arange(1, most + 1).double().square()
    self._cumulative = (weights.cumsum(0) / weights.sum()).float().to(device)
    self.noise = torch.zeros(num_envs, num_actions, device=device)
    self.left = torch.zeros(num_envs, dtype=torch.int64, device=device)
    """Steps for which the noise stays."""

  def next(self) -> torch.Tensor:
    """Return the noise of the next step, (num_envs, num_actions)."""
    is_over = self.left <= 0
    drawn = torch.searchsorted(self._cumulative, torch.rand(self.left.shape, device=self.left.device))
    drawn = drawn.clamp(max=len(self._cumulative) - 1) + 1
    self.noise.copy_(torch.where(is_over[:, None], torch.randn_like(self.noise), self.noise))
    self.left.copy_(torch.where(is_over, drawn, self.left) - 1)
    return self.noise
