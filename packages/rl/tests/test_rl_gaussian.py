"""Draws of actions are rsl-rl's."""

import torch
from mjlab_rl.gaussian import Gaussian
from rsl_rl.modules import GaussianDistribution


def test_actions_are_drawn_as_rsl_rl_draws_them_bit_for_bit() -> None:
  draws = []
  for kind in (GaussianDistribution, Gaussian):
    distribution = kind(3, init_std=0.7)
    distribution.update(torch.linspace(-2.0, 2.0, 15, requires_grad=True).view(5, 3))
    torch.manual_seed(0)
    draws.append(distribution.sample())
  assert torch.equal(*draws)
  assert not draws[1].requires_grad
