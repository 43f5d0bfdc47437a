"""Declared state: tensors that are saved, restored and reset with the object that owns them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import torch
from torch import Tensor

from mjlab_core.errors import MjlabError
from mjlab_core.indexing import where_
from mjlab_core.names import unknown

T = TypeVar("T", bound="Stateful")

_MARK = "_is_declared_state"


@dataclass(slots=True)
class _Declared:
  """One tensor of state."""

  tensor: Tensor
  fill: Tensor | None
  """Value after a reset; None leaves a reset to the owner."""
  shared: bool


@dataclass(slots=True)
class _Registry:
  """State and children of one object, by attribute name."""

  tensors: dict[str, _Declared] = field(default_factory=dict)
  children: dict[str, Any] = field(default_factory=dict)
  made: dict[int, _Declared] = field(default_factory=dict)
  """Declared tensors that no attribute holds yet, by identity."""
  owned: bool = False


class Stateful:
  """Base of objects that keep state from one step to the next.

  State is declared where it is made, as with `torch.nn.Module.register_buffer`:

      self.peak = self.state((4,))  # (num_envs, 4), zeros

  Declared state is part of `state_dict`. It is written in place; assigning another tensor to the attribute raises.
  A Stateful object that is assigned to an attribute becomes a child, and its state a part of this object's state. An
  object has one owner, the first; assigned elsewhere it is a plain reference. Several children are kept in a
  `StatefulDict`.

  The attributes `num_envs` and `device` must exist before state is declared.
  """

  num_envs: int
  device: torch.device

  def state(
    self,
    shape: Sequence[int] = (),
    *,
    fill: Tensor | float = 0.0,
    dtype: torch.dtype = torch.float32,
    shared: bool = False,
  ) -> Tensor:
    """Return a new tensor, to be assigned to an attribute, that is state of this object.

    Args:
      shape: shape of one world's state.
      fill: initial value, and the value after `refill`: a number, or a tensor that broadcasts to the whole state.
      dtype: type of the tensor.
      shared: one state for all worlds, of shape `shape`, which resets leave alone. Otherwise (num_envs, *shape).
    """
    try:
      size = tuple(shape) if shared else (self.num_envs, *shape)
      tensor = torch.empty(size, device=self.device, dtype=dtype)
    except AttributeError as error:
      raise MjlabError(f"{_label(self)}: call super().__init__(env) before declaring state.") from error
    initial = torch.as_tensor(fill).detach().to(tensor).clone()
    return self._declare(tensor.copy_(initial), initial, shared)

  def state_of(self, memory: Tensor, *, shared: bool = False) -> Tensor:
    """Declare existing memory, to be assigned to an attribute, as state that only the owner resets.

    Args:
      memory: (num_envs, ...), or any shape if `shared`.
      shared: the first axis is not the worlds.
    """
    return self._declare(memory, None, shared)

  def _declare(self, tensor: Tensor, fill: Tensor | None, shared: bool) -> Tensor:
    _registry(self).made[id(tensor)] = _Declared(tensor, fill, shared)
    setattr(tensor, _MARK, True)
    return tensor

  def __setattr__(self, name: str, value: Any) -> None:
    registry: _Registry | None = self.__dict__.get("_registry")
    if registry is not None or isinstance(value, Stateful):
      _register(self, registry or _registry(self), name, value)
    object.__setattr__(self, name, value)

  def undeclared(self, path: str = "self") -> dict[str, Tensor]:
    """Return the tensors, in attributes here and in children, that no object declared as state, by dotted name."""
    registry = _registry(self)
    found: dict[str, Tensor] = {}
    for name, value in vars(self).items():
      found |= _undeclared(value, f"{path}.{name}")
    for name, child in registry.children.items():
      found |= child.undeclared(f"{path}.{name}")
    return found

  # Saving and loading

  def state_dict(self) -> dict[str, Any]:
    """Return clones of the declared state by attribute name, with one nested dict per child."""
    registry = _registry(self)
    if registry.made:
      shapes = ", ".join(str(tuple(made.tensor.shape)) for made in registry.made.values())
      raise MjlabError(
        f"{_label(self)}: state of shape {shapes} is not an attribute; assign what self.state() returns."
      )
    state: dict[str, Any] = {name: declared.tensor.detach().clone() for name, declared in registry.tensors.items()}
    return state | {name: child.state_dict() for name, child in registry.children.items()}

  def load_state_dict(self, state: Mapping[str, Any]) -> None:
    """Write a state from `state_dict` into this object's tensors, in place; check all before writing any.

    Raises:
      MjlabError: a name is missing or unknown, or a shape or dtype differs; the message gives the full name.
    """
    refuse_state(self.state_problems(state))
    self.restore(state)

  def state_problems(self, state: Mapping[str, Any], path: str = "") -> Iterator[str]:
    """Yield the reasons why `load_state_dict` refuses a state, each with the full name.

    Args:
      state: the state to check.
      path: name of this object; its class if empty.
    """
    path, registry = path or type(self).__name__, _registry(self)
    if not isinstance(state, Mapping):
      yield f"{path}: expected a mapping, got {type(state).__name__}."
      return
    expected = [*registry.tensors, *registry.children]
    for name in expected:
      if name not in state:
        yield f"{path}.{name}: missing from the saved state, which has: {', '.join(state) or 'nothing'}."
      elif name in registry.tensors:
        yield from _tensor_problems(state[name], registry.tensors[name].tensor, f"{path}.{name}")
      else:
        yield from registry.children[name].state_problems(state[name], f"{path}.{name}")
    yield from (unknown("saved entry", name, expected, owner=path) for name in state if name not in expected)

  def restore(self, state: Mapping[str, Any], mask: Tensor | None = None) -> None:
    """Write a state of this very object back, in place and unchecked.

    Args:
      state: an earlier `state_dict`.
      mask: worlds to restore, bool (num_envs,); all if None. Shared state is always restored.
    """
    registry = _registry(self)
    with torch.no_grad():
      for name, declared in registry.tensors.items():
        if mask is None or declared.shared:
          declared.tensor.copy_(state[name])
        else:
          where_(declared.tensor, mask, state[name])
    for name, child in registry.children.items():
      child.restore(state[name], mask)

  def refill(self, mask: Tensor) -> None:
    """Write the initial value into the state of the worlds in `mask`, bool (num_envs,), here and in all children.

    Shared state and state of existing memory stay.
    """
    registry = _registry(self)
    for declared in registry.tensors.values():
      if declared.fill is not None and not declared.shared:
        where_(declared.tensor, mask, declared.fill)
    for child in registry.children.values():
      child.refill(mask)


class StatefulDict(Stateful, dict[str, T]):
  """Dictionary of children by name; the state of each entry is part of its state."""

  def __init__(self, items: Mapping[str, T] | None = None) -> None:
    super().__init__()
    _registry(self).children = self
    for name, child in (items or {}).items():
      self[name] = child

  def __setitem__(self, name: str, child: T) -> None:
    super().__setitem__(name, child)
    _registry(child).owned = True


def refuse_state(problems: Iterator[str]) -> None:
  """Raise MjlabError with the first of the reasons why a state does not fit, if there is one."""
  for problem in problems:
    raise MjlabError(problem)


def _registry(owner: Stateful) -> _Registry:
  return owner.__dict__.setdefault("_registry", _Registry())


def _register(owner: Stateful, registry: _Registry, name: str, value: Any) -> None:
  """Register an assigned tensor or child as state of `owner`."""
  made = registry.made.pop(id(value), None)
  if made is not None:
    registry.tensors[name] = made
  elif name in registry.tensors and value is not registry.tensors[name].tensor:
    raise MjlabError(
      f"{_label(owner)}: the state '{name}' cannot be replaced. Write into it: self.{name}.copy_(x), "
      f"self.{name}.mul_(x), or where_(self.{name}, mask, x) for some worlds."
    )
  if name in registry.children and value is not registry.children[name]:
    _registry(registry.children.pop(name)).owned = False
  if isinstance(value, Stateful) and not _registry(value).owned:
    registry.children[name], _registry(value).owned = value, True


def _undeclared(value: Any, path: str) -> dict[str, Tensor]:
  """Return the tensors in a value, also in its containers, that are not declared."""
  if isinstance(value, Tensor):
    return {} if hasattr(value, _MARK) else {path: value}
  items: dict[str, Any] = {}
  if isinstance(value, dict) and not isinstance(value, Stateful):
    items = {f"{path}[{key!r}]": item for key, item in value.items()}
  elif isinstance(value, list | tuple):
    items = {f"{path}[{index}]": item for index, item in enumerate(value)}
  return {name: tensor for where, item in items.items() for name, tensor in _undeclared(item, where).items()}


def _label(owner: Stateful) -> str:
  name = getattr(owner, "name", "")
  kind = type(owner).__name__
  return f"{kind} '{name}'" if name and name != kind else kind


def _tensor_problems(saved: Any, here: Tensor, path: str) -> Iterator[str]:
  if not isinstance(saved, Tensor):
    yield f"{path}: expected a tensor, got {type(saved).__name__}."
  elif saved.shape != here.shape:
    yield f"{path}: saved shape {tuple(saved.shape)}, here {tuple(here.shape)}."
  # Precision may differ between engines; the kind of number may not.
  elif saved.dtype != here.dtype and not (saved.is_floating_point() and here.is_floating_point()):
    yield f"{path}: saved dtype {saved.dtype}, here {here.dtype}."
