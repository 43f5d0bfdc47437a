"""Draws from distributions, whole batches at a time and without a host sync, and seeds.

Bounds are numbers or tensors that broadcast against `shape`. The number of random numbers depends on `shape` alone, so
the draws of a world do not depend on the selection of other worlds.
"""

from __future__ import annotations

import math
import random
import secrets
from collections.abc import Callable, Sequence
from typing import TypedDict, Unpack

import numpy as np
import torch
from torch import Tensor


class Options(TypedDict, total=False):
  """Source, place and type of a draw."""

  generator: torch.Generator | None
  """None is torch's global one."""
  device: torch.device | str | None
  dtype: torch.dtype
  """float32 by default."""


def uniform(
  lo: Tensor | float,
  hi: Tensor | float,
  shape: Sequence[int],
  **like: Unpack[Options],
) -> Tensor:
  """Draw uniformly from [lo, hi], of shape `shape`."""
  return torch.rand(tuple(shape), **like).mul_(hi - lo).add_(lo)


def log_uniform(
  lo: Tensor | float,
  hi: Tensor | float,
  shape: Sequence[int],
  **like: Unpack[Options],
) -> Tensor:
  """Draw exp(uniform(log lo, log hi)) in [lo, hi], of shape `shape`; both bounds positive."""
  log_lo = lo.log() if isinstance(lo, Tensor) else math.log(lo)
  log_hi = hi.log() if isinstance(hi, Tensor) else math.log(hi)
  return uniform(log_lo, log_hi, shape, **like).exp_()


def gaussian(
  mean: Tensor | float,
  std: Tensor | float,
  shape: Sequence[int],
  **like: Unpack[Options],
) -> Tensor:
  """Draw from the normal distribution with `mean` and standard deviation `std`, of shape `shape`."""
  return torch.randn(tuple(shape), **like).mul_(std).add_(mean)


def truncated_normal(
  mean: Tensor | float,
  std: Tensor | float,
  lo: Tensor | float,
  hi: Tensor | float,
  shape: Sequence[int],
  **like: Unpack[Options],
) -> Tensor:
  """Draw from the normal distribution conditioned on [lo, hi], of shape `shape`, by inversion.

  Works in float64 inside. An interval more than five standard deviations above the mean loses resolution.
  """
  wide: Options = {**like, "dtype": torch.float64}
  u = torch.rand(tuple(shape), **wide)
  low, high = torch.zeros_like(u).add_(lo), torch.zeros_like(u).add_(hi)
  safe = std.double().clamp_min(1e-300) if isinstance(std, Tensor) else max(std, 1e-300)
  below, above = (torch.special.ndtr((bound - mean) / safe) for bound in (low, high))
  z = torch.special.ndtri(below + u * (above - below))
  x = torch.nan_to_num_(z, posinf=40.0, neginf=-40.0).mul_(std).add_(mean)
  return x.clamp_(low, high).to(like.get("dtype", torch.float32))


def call_where(mask: Tensor, fn: Callable[[Tensor], object], generator: torch.Generator) -> None:
  """Call `fn(mask)`, which changes and draws numbers for the worlds in `mask` only, bool (num_envs,).

  A GPU would have to wait for the mask, so the call is always made there. On a CPU an empty mask skips it. `fn` draws
  there from a separate stream, which `generator` seeds with one draw, so later draws do not depend on the call.
  """
  if mask.device.type != "cpu":
    fn(mask)
    return
  seed = torch.empty((), dtype=torch.int64).random_(generator=generator)
  if not mask.numpy().any():
    return
  state = generator.get_state()
  generator.manual_seed(int(seed.numpy()))
  try:
    fn(mask)
  finally:
    generator.set_state(state)


def draw_seed() -> int:
  """Return a seed from the operating system, in [0, 2^31)."""
  return secrets.randbelow(2**31)


def seed_everything(seed: int | None = None) -> int:
  """Seed the global generators of Python, NumPy and torch (all devices); return the seed, drawn if None."""
  seed = draw_seed() if seed is None else seed
  random.seed(seed)
  # The legacy call seeds libraries that draw from NumPy's global state.
  np.random.seed(seed % 2**32)  # noqa: NPY002
  torch.manual_seed(seed)
  return seed


def make_generator(device: torch.device | str, seed: int) -> torch.Generator:
  """Return a generator on `device` that starts from `seed`."""
  return torch.Generator(device=device).manual_seed(seed)
