"""Observation of a trial call: use of scalars, reads on the host, and writes to undeclared memory."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from typing import Any, Self

import torch
from mjlab_core import MjlabError, Stateful
from mjlab_core.torch_internals import SEES_OPERATIONS, OperationMode, writes_to
from torch.fx.node import map_aggregate
from torch.overrides import TorchFunctionMode


class Watch(TorchFunctionMode):
  """Context that notes the use of scalars and reads of tensors on the host.

  A scalar that is only stored can later be changed by a write. A scalar that is used may have changed other values. A
  recorded step cannot read tensors on the host.
  """

  def __init__(self, scalars: Mapping[str, torch.Tensor] | None = None) -> None:
    super().__init__()
    self.used: set[str] = set()
    self._name_of = {id(scalar): name for name, scalar in (scalars or {}).items()}
    self._calls_host = False
    self._inner = _HostReads()

  @property
  def reads_host(self) -> bool:
    """True if a tensor was read on the host, or if that cannot be seen."""
    return not SEES_OPERATIONS or self._calls_host or self._inner.found

  def __enter__(self) -> Self:
    self._inner.__enter__()
    return super().__enter__()

  def __exit__(self, exc_type: Any, exc_val: Any, exc_tb: Any) -> None:
    super().__exit__(exc_type, exc_val, exc_tb)
    self._inner.__exit__(exc_type, exc_val, exc_tb)

  def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
    if self._name_of:
      map_aggregate((args, kwargs), self._note)
    self._calls_host |= getattr(func, "__name__", "") in ("tolist", "numpy", "__array__")
    return func(*args, **(kwargs or {}))

  def _note(self, leaf: Any) -> Any:
    if id(leaf) in self._name_of:
      self.used.add(self._name_of[id(leaf)])
    return leaf


class _HostReads(OperationMode):
  """Observer of operations, also inside of torch, that copy a number to the host."""

  found = False

  @classmethod
  def _should_skip_dynamo(cls) -> bool:
    """Return False. The value True imports the compiler, which takes a second; a trial call is never compiled."""
    return False

  def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
    self.found |= "_local_scalar_dense" in str(func)
    return func(*args, **(kwargs or {}))


class PlainTensors(OperationMode):
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


def _undeclared_memory(obj: Any) -> dict[str, tuple[int, int]]:
  """Return address and number of writes of each tensor of a class term that is not declared as state."""
  found: dict[str, tuple[int, int]] = {}
  for path, tensor in obj.undeclared().items() if isinstance(obj, Stateful) else ():
    found[path] = tensor.data_ptr(), writes_to(tensor)
  return found


@contextmanager
def only_declared(obj: Any) -> Generator[None]:
  """Refuse changes of a trial call to tensors of a class term that are not declared as state.

  Raises:
    MjlabError: the call replaced such a tensor, or wrote into one.
  """
  before = _undeclared_memory(obj)
  yield
  if changed := [path for path, memory in _undeclared_memory(obj).items() if before.get(path) != memory]:
    raise MjlabError(
      f"a trial call replaced, or wrote into, {', '.join(changed)}, which is not declared as state: a recorded step "
      "cannot follow another tensor, and a checkpoint does not contain it. Declare state in __init__, "
      "self.x = self.state(...), and write into it: copy_, mul_, where_."
    )
