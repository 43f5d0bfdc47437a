"""A torch tensor over engine memory."""

from collections.abc import Callable

import torch


class TorchArray(torch.Tensor):
  """A zero-copy tensor over an engine's array: writing to it writes to the simulation.

  It is a `torch.Tensor` in every respect; operations on it return plain tensors. The engine that made it keeps the
  memory alive for as long as the simulation is open.
  """

  # Torch's own switch for "results are plain tensors"; its stub declares a method.
  __torch_function__ = torch._C._disabled_torch_function_impl  # pyright: ignore[reportAssignmentType]  # ty: ignore[incompatible-method-override]

  @staticmethod
  def over(view: Callable[[], torch.Tensor]) -> "TorchArray":
    """What `view` makes as a TorchArray, sharing its memory and its version counter.

    A field may be asked for first in inference mode, where tensors are made that nobody can write to outside of it.
    """
    with torch.inference_mode(False):
      return view().as_subclass(TorchArray)
