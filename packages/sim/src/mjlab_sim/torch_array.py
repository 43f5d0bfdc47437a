"""A torch tensor over engine memory."""

import torch


class TorchArray(torch.Tensor):
  """A zero-copy tensor over an engine's array: writing to it writes to the simulation.

  It is a `torch.Tensor` in every respect; operations on it return plain tensors. The engine that made it keeps the
  memory alive for as long as the simulation is open.
  """

  # Torch's own switch for "results are plain tensors"; its stub declares a method.
  __torch_function__ = torch._C._disabled_torch_function_impl  # pyright: ignore[reportAssignmentType]  # ty: ignore[incompatible-method-override]

  @staticmethod
  def over(tensor: torch.Tensor) -> "TorchArray":
    """`tensor` as a TorchArray, sharing its memory and its version counter."""
    return tensor.as_subclass(TorchArray)
