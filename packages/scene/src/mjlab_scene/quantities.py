"""A property that is computed at most once for each state of the simulation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, overload

import torch


class _Clock(Protocol):
  @property
  def epoch(self) -> int: ...
  @property
  def is_capturing(self) -> bool: ...


class QuantityCache:
  """Values of an object's `cached_quantity` properties, valid for one epoch of its simulation."""

  def __init__(self, sim: _Clock) -> None:
    self._sim = sim
    self._epoch: tuple[int, bool] | None = None
    self._values: dict[str, torch.Tensor] = {}

  def get(self, name: str, compute: Callable[[Any], torch.Tensor], owner: Any) -> torch.Tensor:
    """The value under `name`, computed from `owner` if this epoch has none yet."""
    # What was computed outside a recording is no part of it, and what a recording computes is not there yet.
    epoch = (self._sim.epoch, self._sim.is_capturing)
    if epoch != self._epoch:
      self._values.clear()
      self._epoch = epoch
    value = self._values.get(name)
    if value is None:
      value = compute(owner)
      self._values[name] = value
    return value


class cached_quantity:
  """Decorator of a method without arguments; its object offers a `QuantityCache` as `cache`.

  The tensor may be shared by every reader of the epoch and must not be written to.
  """

  def __init__(self, compute: Callable[[Any], torch.Tensor]) -> None:
    self._compute = compute
    self._name = getattr(compute, "__name__", "")
    self.__doc__ = compute.__doc__

  @overload
  def __get__(self, instance: None, owner: type) -> cached_quantity: ...
  @overload
  def __get__(self, instance: Any, owner: type | None = None) -> torch.Tensor: ...
  def __get__(self, instance: Any, owner: type | None = None) -> torch.Tensor | cached_quantity:
    if instance is None:
      return self
    return instance.cache.get(self._name, self._compute, instance)
