"""Draws from distributions, whole batches at a time and without a host sync, and the check of their ranges at build.

Bounds are numbers or tensors that broadcast against `shape`. The amount of randomness consumed depends on `shape`
alone, so that what a world draws does not depend on which worlds are asked for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real

import torch
from torch import Tensor


def uniform(
  lo: Tensor | float,
  hi: Tensor | float,
  shape: Sequence[int],
  *,
  generator: torch.Generator | None = None,
  device: torch.device | str | None = None,
  dtype: torch.dtype = torch.float32,
) -> Tensor:
  """Uniform in [lo, hi], of shape `shape`."""
  return torch.rand(tuple(shape), generator=generator, device=device, dtype=dtype).mul_(hi - lo).add_(lo)


def log_uniform(
  lo: Tensor | float,
  hi: Tensor | float,
  shape: Sequence[int],
  *,
  generator: torch.Generator | None = None,
  device: torch.device | str | None = None,
  dtype: torch.dtype = torch.float32,
) -> Tensor:
  """exp(uniform(log lo, log hi)) in [lo, hi], of shape `shape`; both bounds positive."""
  log_lo = lo.log() if isinstance(lo, Tensor) else math.log(lo)
  log_hi = hi.log() if isinstance(hi, Tensor) else math.log(hi)
  return uniform(log_lo, log_hi, shape, generator=generator, device=device, dtype=dtype).exp_()


def gaussian(
  mean: Tensor | float,
  std: Tensor | float,
  shape: Sequence[int],
  *,
  generator: torch.Generator | None = None,
  device: torch.device | str | None = None,
  dtype: torch.dtype = torch.float32,
) -> Tensor:
  """Normal with `mean` and standard deviation `std`, of shape `shape`, one independent draw per element."""
  return torch.randn(tuple(shape), generator=generator, device=device, dtype=dtype).mul_(std).add_(mean)


def truncated_normal(
  mean: Tensor | float,
  std: Tensor | float,
  lo: Tensor | float,
  hi: Tensor | float,
  shape: Sequence[int],
  *,
  generator: torch.Generator | None = None,
  device: torch.device | str | None = None,
  dtype: torch.dtype = torch.float32,
) -> Tensor:
  """The normal distribution conditioned on [lo, hi], of shape `shape`, by its inverse distribution function.

  Works in float64 inside. An interval more than five standard deviations above the mean loses resolution.
  """

  def wide(x: Tensor | float) -> Tensor | float:
    return x.double() if isinstance(x, Tensor) else x

  mean, std, lo, hi = wide(mean), wide(std), wide(lo), wide(hi)
  safe = std.clamp_min(1e-300) if isinstance(std, Tensor) else max(std, 1e-300)
  u = torch.rand(tuple(shape), generator=generator, device=device, dtype=torch.float64)
  below = torch.special.ndtr(torch.zeros_like(u).add_(lo).sub_(mean).div_(safe))
  above = torch.special.ndtr(torch.zeros_like(u).add_(hi).sub_(mean).div_(safe))
  z = torch.special.ndtri(below + u * (above - below))
  x = torch.nan_to_num_(z, posinf=40.0, neginf=-40.0).mul_(std).add_(mean)
  x = x.clamp_(min=lo) if not isinstance(lo, Tensor) else torch.maximum(x, lo)
  x = x.clamp_(max=hi) if not isinstance(hi, Tensor) else torch.minimum(x, hi)
  return x.to(dtype)


def check_bounds(name: str, bounds: object, *, minimum: float = -math.inf, finite: bool = False) -> None:
  """`check_range` of what a config holds as a pair, and of numbers that are finite if these must be.

  Raises:
    ValueError: it is no pair of numbers, or no such range; the message begins with `name`.
  """
  if not (isinstance(bounds, Sequence) and len(bounds) == 2 and all(isinstance(bound, Real) for bound in bounds)):
    raise ValueError(f"{name}: must be two numbers, the lowest and the highest, got {bounds!r}.")
  lo, hi = (float(bound) for bound in bounds)
  check_range(name, lo, hi, minimum=minimum)
  if finite and not (math.isfinite(lo) and math.isfinite(hi)):
    raise ValueError(f"{name}: range ({lo}, {hi}) must be finite.")


def check_range(
  name: str,
  lo: float,
  hi: float,
  *,
  minimum: float = -math.inf,
  maximum: float = math.inf,
  open_minimum: bool = False,
) -> None:
  """Checks, at build, that lo <= hi are numbers inside [minimum, maximum], or (minimum, maximum] if `open_minimum`.

  Raises:
    ValueError: not so; the message begins with `name`.
  """
  if math.isnan(lo) or math.isnan(hi):
    raise ValueError(f"{name}: range ({lo}, {hi}) has a bound that is not a number.")
  if lo > hi:
    raise ValueError(f"{name}: range ({lo}, {hi}) is inverted. Did you mean ({hi}, {lo})?")
  if lo < minimum or (open_minimum and lo == minimum):
    raise ValueError(f"{name}: range ({lo}, {hi}) must stay {'above' if open_minimum else 'at or above'} {minimum:g}.")
  if hi > maximum:
    raise ValueError(f"{name}: range ({lo}, {hi}) must stay at or below {maximum:g}.")
