"""Saving and restoring what an object remembers between steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from mjlab_core.masking import where_
from mjlab_core.names import unknown


class StateError(ValueError):
  """A state does not fit the object it is loaded into."""


class Stateful:
  """Base of everything that remembers something from one step to the next.

  The state is found, not declared: every tensor attribute whose first dimension is `self.num_envs`. What differs from
  that is named in three class attributes, which add up over the base classes:

  - `_constants`: attributes of that shape that never change after build and are not saved;
  - `_extra_state`: tensors of another shape that are saved too;
  - `_children`: attributes that are Stateful, or a mapping or sequence of Stateful (None is skipped).
  """

  num_envs: int
  _constants: ClassVar[frozenset[str]] = frozenset()
  _extra_state: ClassVar[tuple[str, ...]] = ()
  _children: ClassVar[tuple[str, ...]] = ()

  def state_dict(self) -> dict[str, Any]:
    """Clones of all state tensors by attribute name, with one nested dict per child."""
    state: dict[str, Any] = {name: tensor.detach().clone() for name, tensor in self._state_tensors().items()}
    for name, children in self._state_children().items():
      state[name] = (
        children.state_dict()
        if isinstance(children, Stateful)
        else {key: child.state_dict() for key, child in children.items()}
      )
    return state

  def load_state_dict(self, state: Mapping[str, Any]) -> None:
    """Writes a state from `state_dict` into this object's tensors, in place; all is checked before any is written.

    Raises:
      StateError: a name is missing or unknown, or a shape or kind of number differs; the message gives the full name.
    """
    writes: list[tuple[Tensor, Tensor]] = []
    self._collect(state, type(self).__name__, writes)
    with torch.no_grad():
      for target, source in writes:
        target.copy_(source)

  def check_state_dict(self, state: Mapping[str, Any]) -> None:
    """Raises what `load_state_dict` would raise, and writes nothing: for owners of several states."""
    self._collect(state, type(self).__name__, [])

  def take_back(self, before: Mapping[str, Any], mask: Tensor) -> None:
    """Undoes what was remembered since `before`, a `state_dict`, in all worlds but those of `mask`, bool (num_envs,).

    In place; what has no row per world is undone altogether.
    """
    extra = _inherited(type(self), "_extra_state")
    for name, tensor in self._state_tensors().items():
      if name in extra:
        tensor.copy_(before[name])
      else:
        where_(tensor, ~mask, before[name])
    for name, child in self._state_children().items():
      for key, item in (("", child),) if isinstance(child, Stateful) else child.items():
        item.take_back(before[name][key] if key else before[name], mask)

  def _collect(self, state: Mapping[str, Any], path: str, writes: list[tuple[Tensor, Tensor]]) -> None:
    tensors, children = self._state_tensors(), self._state_children()
    _check_keys(state, [*tensors, *children], path)
    for name, target in tensors.items():
      source = state[name]
      if not isinstance(source, Tensor):
        raise StateError(f"{path}.{name}: expected a tensor, got {type(source).__name__}.")
      if source.shape != target.shape:
        raise StateError(f"{path}.{name}: saved shape {tuple(source.shape)}, here {tuple(target.shape)}.")
      # Precision may differ between engines; the kind of number may not.
      if source.dtype != target.dtype and not (source.is_floating_point() and target.is_floating_point()):
        raise StateError(f"{path}.{name}: saved dtype {source.dtype}, here {target.dtype}.")
      writes.append((target, source))
    for name, child in children.items():
      if not isinstance(state[name], Mapping):
        raise StateError(f"{path}.{name}: expected a mapping, got {type(state[name]).__name__}.")
      if isinstance(child, Stateful):
        child._collect(state[name], f"{path}.{name}", writes)
        continue
      _check_keys(state[name], list(child), f"{path}.{name}")
      for key, item in child.items():
        item._collect(state[name][key], f"{path}.{name}.{key}", writes)

  def _state_tensors(self) -> dict[str, Tensor]:
    extra, constants = _inherited(type(self), "_extra_state"), _inherited(type(self), "_constants")
    num_envs = getattr(self, "num_envs", None)
    tensors = {
      name: value
      for name, value in vars(self).items()
      if isinstance(value, Tensor)
      and name not in constants
      and (name in extra or (value.dim() > 0 and value.shape[0] == num_envs))
    }
    if absent := [name for name in extra if name not in tensors]:
      raise StateError(f"{type(self).__name__}: _extra_state names {absent}, which are not tensor attributes.")
    return tensors

  def _state_children(self) -> dict[str, Stateful | dict[str, Stateful]]:
    children: dict[str, Stateful | dict[str, Stateful]] = {}
    for name in _inherited(type(self), "_children"):
      value = getattr(self, name)
      if isinstance(value, Stateful):
        children[name] = value
      elif value is not None:
        items = value.items() if isinstance(value, Mapping) else enumerate(value)
        children[name] = {str(key): child for key, child in items if isinstance(child, Stateful)}
    return children


def _inherited(cls: type, attribute: str) -> list[str]:
  """The names listed under `attribute` by a class and its bases, base first."""
  return list(dict.fromkeys(name for base in reversed(cls.__mro__) for name in vars(base).get(attribute, ())))


def _check_keys(state: Mapping[str, Any], expected: list[str], path: str) -> None:
  for name in expected:
    if name not in state:
      raise StateError(f"{path}.{name}: missing from the saved state, which has: {', '.join(state) or 'nothing'}.")
  for name in state:
    if name not in expected:
      raise StateError(unknown("saved entry", name, expected, owner=path))
