"""Tensors over engine memory, and their version counters.

This is the only module with private names of torch. `PRIVATE` lists them with the reason; without one of them the same
code runs slower.
"""

import itertools
import operator
from collections.abc import Callable, Iterable

import torch

PRIVATE = {
  "torch.Tensor._version": "counts in-place writes to a tensor; without it every read computes again",
  "torch._C._disabled_torch_function_impl": "makes results plain tensors; without it they are TorchArrays, too",
}

_clock = itertools.count(1)


def _always_new(tensor: torch.Tensor) -> int:
  """Return another number at each call, as if the tensor were written between any two."""
  return next(_clock)


version_of: Callable[[torch.Tensor], int] = (
  operator.attrgetter("_version") if hasattr(torch.Tensor, "_version") else _always_new
)
"""Return a number that grows with every in-place write to a tensor or to a view of the same memory."""


def versions(tensors: Iterable[torch.Tensor]) -> int:
  """Return a number that grows with every in-place write to one of `tensors`."""
  return sum(map(version_of, tensors))


class TorchArray(torch.Tensor):
  """A zero-copy tensor over an engine's array: writing to it writes to the simulation.

  It is a `torch.Tensor` in every respect; operations on it return plain tensors. The engine that made it keeps the
  memory alive for as long as the simulation is open.
  """

  if hasattr(torch._C, "_disabled_torch_function_impl"):
    __torch_function__ = torch._C._disabled_torch_function_impl  # pyright: ignore[reportAssignmentType]  # ty: ignore[incompatible-method-override]

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
