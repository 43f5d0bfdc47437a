"""Read-only configs of built terms. Without the lock, a change to them would be ignored without an error."""

from __future__ import annotations

import copy
import dataclasses
import functools
from typing import Any, NoReturn, TypeVar, cast

from mjlab_core import MjlabError

T = TypeVar("T")


def lock(cfg: T, advice: str, live: frozenset[str] = frozenset()) -> T:
  """Make a config read-only, in place, and return it. Containers in its fields become read-only copies.

  A copy by `copy` or `dataclasses.replace` can be changed again.

  Args:
    cfg: a dataclass that belongs to the caller. A frozen dataclass, or another object, is not changed.
    advice: text of the error. It names the call that makes a change.
    live: fields that may still be assigned.
  """
  if _is_open(cfg):
    attributes = vars(cfg)
    for field in dataclasses.fields(cast(Any, cfg)):
      if field.name in attributes:
        attributes[field.name] = locked(attributes[field.name], advice)
    attributes["_lock"] = (advice, live)
    object.__setattr__(cfg, "__class__", _locked_class(type(cfg)))
  return cfg


def locked(value: Any, advice: str) -> Any:
  """Return a read-only copy of a dictionary, list or dataclass, and any other value unchanged."""
  if type(value) is dict:
    return LockedDict(value, advice)
  if type(value) is list:
    return tuple(locked(item, advice) for item in value)
  return lock(copy.copy(value), advice) if _is_open(value) and not callable(value) else value


class LockedDict(dict[Any, Any]):
  """Read-only dictionary. A copy of it is a plain dictionary."""

  def __init__(self, items: dict[Any, Any], advice: str) -> None:
    super().__init__({key: locked(value, advice) for key, value in items.items()})
    self._advice = advice

  def _refuse(self, *_: Any, **__: Any) -> NoReturn:
    raise MjlabError(self._advice)

  __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse  # type: ignore[assignment]

  def __reduce_ex__(self, protocol: Any, /) -> Any:
    return dict, (dict(self),)


def _is_open(value: Any) -> bool:
  """Return True for an instance of a dataclass with assignable fields."""
  if not dataclasses.is_dataclass(value) or isinstance(value, type) or not hasattr(value, "__dict__"):
    return False
  return not type(value).__dataclass_params__.frozen and "_lock" not in vars(value)  # type: ignore[attr-defined]


def _blank(cls: type) -> Any:
  return object.__new__(cls)


@functools.cache
def _locked_class(cls: type) -> type:
  def refuse(self: Any, name: str, *value: Any) -> None:
    advice, live = vars(self).get("_lock", ("", (name,)))
    if name not in live:
      raise MjlabError(advice)
    object.__setattr__(self, name, *value)

  def copied(self: Any, protocol: Any) -> Any:
    return _blank, (cls,), {name: value for name, value in vars(self).items() if name != "_lock"}

  def equal(self: Any, other: Any) -> bool:
    names = [field.name for field in dataclasses.fields(self) if field.compare]
    return isinstance(other, cls) and all(getattr(self, name) == getattr(other, name) for name in names)

  body: dict[str, Any] = {"__setattr__": refuse, "__delattr__": refuse, "__reduce_ex__": copied}
  if cls.__eq__ is not object.__eq__:
    body["__eq__"] = equal
  body |= {name: getattr(cls, name) for name in ("__module__", "__qualname__", "__doc__")}
  return type(cls.__name__, (cls,), body)
