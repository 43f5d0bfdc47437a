"""Distributions of a randomised value."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import accumulate
from typing import Annotated, Any, ClassVar, Protocol, Unpack

import torch
from mjlab_core import (
  Bounds,
  Finite,
  Limits,
  MjlabError,
  NonNegative,
  Positive,
  check_fields,
  check_value,
  log_uniform,
  truncated_normal,
  uniform,
)
from mjlab_core.sampling import Options
from torch import Tensor

SampleFunction = Callable[..., Tensor]
"""Function `(shape, *, generator, device, dtype)` that returns independent draws of `shape`.

It draws without a host sync, from the same amount of randomness every time.
"""


class Distribution(Protocol):
  """Distribution of a randomised value. Any object with these three methods is one."""

  def check(self, name: str) -> None:
    """Raise MjlabError, beginning with `name`, if the parameters are impossible."""
    ...

  def support(self) -> tuple[float, float]:
    """Return the smallest and largest value that may be drawn."""
    ...

  def sample(
    self, shape: Sequence[int], *, generator: torch.Generator | None, device: torch.device, dtype: torch.dtype
  ) -> Tensor:
    """Return independent draws of this shape, without a host sync, from the same amount of randomness every time."""
    ...


@dataclass(frozen=True)
class _Bounded:
  """Distribution within [lo, hi], its last two fields."""

  def check(self, name: str) -> None:
    """Raise ConfigError, beginning with `name`, if the parameters are impossible."""
    check_fields(self, name)
    check_value(f"{name}: (lo, hi)", self.support(), Bounds)

  def support(self) -> tuple[float, float]:
    """Return (lo, hi)."""
    lo, hi = astuple(self)[-2:]
    return lo, hi


@dataclass(frozen=True)
class _Parametric(_Bounded):
  """Distribution with a draw that is a function of its parameters in their order."""

  _draw: ClassVar[Callable[..., Tensor]]

  def sample(self, shape: Sequence[int], **options: Unpack[Options]) -> Tensor:
    """Return independent draws of this shape."""
    return type(self)._draw(*astuple(self), shape, **options)


@dataclass(frozen=True)
class Uniform(_Parametric):
  """Every value of [lo, hi] equally likely."""

  lo: Finite
  hi: Finite
  _draw = staticmethod(uniform)


@dataclass(frozen=True)
class LogUniform(_Parametric):
  """Every ratio within [lo, hi] equally likely; for quantities that range over orders of magnitude."""

  lo: Positive
  hi: Positive
  _draw = staticmethod(log_uniform)


@dataclass(frozen=True)
class Gaussian(_Parametric):
  """Normal with this mean and standard deviation, conditioned on [lo, hi]."""

  mean: Finite
  std: NonNegative
  lo: float = -math.inf
  hi: float = math.inf
  _draw = staticmethod(truncated_normal)

  def check(self, name: str) -> None:
    """Raise MjlabError also if [lo, hi] is more than 5 std away from the mean."""
    super().check(name)
    if not self.lo - 5.0 * self.std <= self.mean <= self.hi + 5.0 * self.std:
      raise MjlabError(f"{name}: mean {self.mean} is more than 5 std ({self.std}) outside [{self.lo}, {self.hi}].")


@dataclass(frozen=True)
class Categorical:
  """One of several values, or of several names where a field refers to named elements, with a weight for each."""

  values: Annotated[tuple[float | str, ...], Limits()]
  weights: Annotated[tuple[float, ...] | None, Limits(ge=0)] = None

  def check(self, name: str) -> None:
    """Raise MjlabError if there are no values, or if the weights do not fit them."""
    check_fields(self, name)
    weights = (1.0,) * len(self.values) if self.weights is None else self.weights
    if len(weights) != len(self.values) or not sum(weights):
      raise MjlabError(f"{name}: needs values, and as many weights, not all zero; got {self.values} and {weights}.")

  @property
  def has_names(self) -> bool:
    """True if some values are names."""
    return any(isinstance(x, str) for x in self.values)

  def support(self) -> tuple[float, float]:
    """Return the smallest and largest value; values given by name count as 0."""
    numbers = [0.0 if isinstance(x, str) else x for x in self.values]
    return min(numbers), max(numbers)

  def named(self, ids: Callable[[str], int]) -> Categorical:
    """Return the same distribution with ids instead of names."""
    return replace(self, values=tuple(ids(x) if isinstance(x, str) else x for x in self.values))

  def sample(
    self, shape: Sequence[int], *, generator: torch.Generator | None, device: torch.device, dtype: torch.dtype
  ) -> Tensor:
    """Return independent draws of this shape."""
    return self.prepared(device=device, dtype=dtype)(shape, generator=generator, device=device, dtype=dtype)

  def prepared(self, *, device: torch.device, dtype: torch.dtype) -> SampleFunction:
    """Return `sample` with its table on the device."""
    weights = self.weights or (1.0,) * len(self.values)
    table = torch.tensor(self.values, device=device, dtype=dtype)
    # The last edge is left out, so that rounding cannot reach beyond the table.
    edges = torch.tensor(list(accumulate(w / sum(weights) for w in weights))[:-1], device=device, dtype=torch.float64)

    def sample(shape: Sequence[int], *, generator: torch.Generator | None, **_: Any) -> Tensor:
      u = torch.rand(tuple(shape), generator=generator, device=device, dtype=torch.float64)
      return table[torch.bucketize(u, edges, right=True)]

    return sample


@dataclass(frozen=True)
class Custom(_Bounded):
  """Draws of a function, which must stay within [lo, hi].

  It runs inside a captured step: it must draw from the given generator, and not wait for the device.
  """

  function: SampleFunction
  lo: Finite
  hi: Finite

  def sample(
    self, shape: Sequence[int], *, generator: torch.Generator | None, device: torch.device, dtype: torch.dtype
  ) -> Tensor:
    """Return the draws of the function, clamped to [lo, hi]."""
    return self.function(shape, generator=generator, device=device, dtype=dtype).to(dtype).clamp(self.lo, self.hi)


def joint_sampler(
  distributions: Sequence[Distribution], *, device: torch.device, dtype: torch.dtype
) -> Callable[[tuple[int, ...], torch.Generator | None], Tensor]:
  """Return a function (shape, generator) -> (*shape, k) that draws one column from each of k distributions.

  Columns of one parametric kind are drawn in one go.
  """
  options: dict[str, Any] = {"device": device, "dtype": dtype}
  first = distributions[0]
  if isinstance(first, _Parametric) and all(type(d) is type(first) for d in distributions):
    rows: list[Any] = list(distributions)
    columns = [torch.tensor(column, **options) for column in zip(*map(astuple, rows), strict=True)]
    draw = type(first)._draw
    return lambda shape, generator: draw(*columns, (*shape, len(rows)), generator=generator, **options)
  samplers = [d.prepared(**options) if isinstance(d, Categorical) else d.sample for d in distributions]
  return lambda shape, generator: torch.stack(
    [sample(shape, generator=generator, **options) for sample in samplers], dim=-1
  )
