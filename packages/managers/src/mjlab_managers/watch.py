"""Observation of a trial call: use of scalars, reads on the host, and writes to undeclared memory.

The module needs private names of torch that have no public form. `TorchDispatchMode` sees operations inside of torch,
and `Tensor._version` counts the writes to a tensor. A test fails if a version of torch lacks them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from typing import Any, Self

import torch
from mjlab_core import Stateful
from torch.fx.node import map_aggregate
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from mjlab_managers.parameters import Scalar


class Watch(ExitStack):
  """Context that notes the use of scalars and reads of tensors on the host.

  A scalar that is only stored can later be changed by a write. A scalar that is used may have changed other values. A
  recorded step cannot read tensors on the host.
  """

  def __init__(self, scalars: Mapping[str, Scalar] | None = None) -> None:
    super().__init__()
    self.used: set[str] = set()
    self.reads_host = False
    self._name_of = {
      id(tensor): name
      for name, scalar in (scalars or {}).items()
      for tensor in (scalar if isinstance(scalar, tuple) else (scalar,))
    }

  def __enter__(self) -> Self:
    super().__enter__()
    self.enter_context(_Calls(self))
    self.enter_context(_HostReads(self))
    return self

  def note(self, args: Any) -> None:
    """Note the scalars among the arguments of an operation."""
    if self._name_of:
      self.used.update(self._name_of[id(leaf)] for leaf in _leaves(args) if id(leaf) in self._name_of)


class _Calls(TorchFunctionMode):
  """Observer of calls of torch functions and tensor methods."""

  def __init__(self, watch: Watch) -> None:
    super().__init__()
    self._watch = watch

  def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
    self._watch.note((args, kwargs))
    if getattr(func, "__name__", "") in ("tolist", "numpy", "__array__"):
      self._watch.reads_host = True
    return func(*args, **(kwargs or {}))


class _HostReads(TorchDispatchMode):
  """Observer of operations, also inside of torch, that copy a number to the host."""

  def __init__(self, watch: Watch) -> None:
    super().__init__()
    self._watch = watch

  @classmethod
  def _should_skip_dynamo(cls) -> bool:
    """Return False. The value True imports the compiler, which takes a second; a trial call is never compiled."""
    return False

  def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
    if "_local_scalar_dense" in str(func):
      self._watch.reads_host = True
    return func(*args, **(kwargs or {}))


class PlainTensors(TorchDispatchMode):
  """Mode that has operations work on plain tensors over the arrays of an engine, which a trace requires."""

  def __init__(self) -> None:
    super().__init__()
    self.draws = False
    """True if a random number was drawn."""
    self._plain: dict[int, tuple[torch.Tensor, torch.Tensor | None]] = {}

  @classmethod
  def _should_skip_dynamo(cls) -> bool:
    """Return False, as above."""
    return False

  def make_plain(self) -> None:
    """Make the plain tensors of all arrays that were seen."""
    self._plain = {
      key: (array, array.as_subclass(torch.Tensor) if plain is None else plain)
      for key, (array, plain) in self._plain.items()
    }

  def _replaced(self, value: Any) -> Any:
    if not isinstance(value, torch.Tensor) or type(value) is torch.Tensor:
      return value
    _, plain = self._plain.setdefault(id(value), (value, None))
    return value if plain is None else plain

  def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
    self.draws |= torch.Tag.nondeterministic_seeded in func.tags
    return func(*map_aggregate(args, self._replaced), **map_aggregate(kwargs or {}, self._replaced))


def _leaves(value: Any) -> Iterator[Any]:
  if isinstance(value, dict):
    value = tuple(value.values())
  if isinstance(value, list | tuple):
    for item in value:
      yield from _leaves(item)
  else:
    yield value


def undeclared_memory(obj: Any) -> dict[str, tuple[int, int]]:
  """Return address and number of writes of each tensor of a class term that is not declared as state.

  Writes are counted only for memory that the term owns, not for views or arrays of a simulation.
  """
  if not isinstance(obj, Stateful):
    return {}
  found: dict[str, tuple[int, int]] = {}
  for path, tensor in obj.undeclared().items():
    owned = type(tensor) is torch.Tensor and not tensor._is_view() and not tensor.is_inference()
    found[path] = tensor.data_ptr(), tensor._version if owned else 0
  return found
