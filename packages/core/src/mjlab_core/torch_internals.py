"""Private names of torch, all in this module.

`PRIVATE` lists them with the reason. Requirements of members that use this module are bounded to the tested minor.
Without one of the names the same code works, and is slower.
"""

from __future__ import annotations

import importlib
import itertools
import operator
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Self

import torch

PRIVATE = {
  "torch.Tensor._version": "counts in-place writes to a tensor; without it every read computes again",
  "torch.Tensor._is_view": "tells views, which count writes to other memory; without it no writes are counted",
  "torch._C._disabled_torch_function_impl": "makes results plain tensors; without it they keep their subclass",
  "torch.utils._python_dispatch.TorchDispatchMode": "sees operations inside of torch; without it any may read the host",
}

COUNTS_WRITES = hasattr(torch.Tensor, "_version") and hasattr(torch.Tensor, "_is_view")
"""True if tensors count the writes to them."""
PLAIN_RESULTS: Any = getattr(torch._C, "_disabled_torch_function_impl", None)
"""Value of `__torch_function__` for subclasses whose results are plain tensors; None if torch has none."""

_clock = itertools.count(1)


def always_new(tensor: torch.Tensor) -> int:
  """Return another number at each call, as if the tensor were written between any two."""
  return next(_clock)


version_of: Callable[[torch.Tensor], int] = operator.attrgetter("_version") if COUNTS_WRITES else always_new
"""Return a number that grows with every in-place write to a tensor or to a view of the same memory."""


def writes_to(tensor: torch.Tensor) -> int:
  """Return the number of writes to memory that a plain tensor owns; 0 for other tensors, and where none are counted."""
  owns = COUNTS_WRITES and type(tensor) is torch.Tensor and not tensor._is_view() and not tensor.is_inference()
  return tensor._version if owns else 0


class _Unseeing:
  """Mode that sees no operation."""

  def __enter__(self) -> Self:
    return self

  def __exit__(self, *_: object) -> None: ...


OperationMode: Any = _Unseeing
"""Base of modes that see every operation in `__torch_dispatch__`, also inside of torch, if `SEES_OPERATIONS`."""
with suppress(ImportError, AttributeError):
  OperationMode = importlib.import_module("torch.utils._python_dispatch").TorchDispatchMode
SEES_OPERATIONS = OperationMode is not _Unseeing
