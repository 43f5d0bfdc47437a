"""Tensors over engine memory, and their version counters."""

from collections.abc import Callable, Iterable

import torch
from mjlab_core.torch_internals import PLAIN_RESULTS, version_of


def versions(tensors: Iterable[torch.Tensor]) -> int:
  """Return a number that grows with every in-place write to one of `tensors`."""
  return sum(map(version_of, tensors))


class TorchArray(torch.Tensor):
  """A zero-copy tensor over an engine's array: writing to it writes to the simulation.

  It is a `torch.Tensor` in every respect; operations on it return plain tensors. The engine that made it keeps the
  memory alive for as long as the simulation is open.
  """

  if PLAIN_RESULTS is not None:
    __torch_function__ = PLAIN_RESULTS

  @staticmethod
  def over(view: Callable[[], torch.Tensor]) -> "TorchArray":
    """Return the tensor that `view` makes as a TorchArray, with its memory and version counter.

    A field may be asked for first in inference mode. A tensor made there could not be written outside of it.
    """
    with torch.inference_mode(False):
      return view().as_subclass(TorchArray)


def plain(field: TorchArray) -> torch.Tensor:
  """Return the same memory and version counter as a plain tensor, whose version is read in half the time."""
  return field.as_subclass(torch.Tensor)
