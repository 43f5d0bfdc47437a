"""Parameters of terms: signatures, checks of given values, and numbers as scalars on the device."""

from __future__ import annotations

import functools
import inspect
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from numbers import Real
from typing import Any

import torch
from mjlab_core import unknown
from mjlab_core.constraints import named_problem, resolved_hints

Scalar = torch.Tensor | tuple[torch.Tensor, ...]
"""Number, or tuple of numbers, as 0-d float64 tensors on the device."""

_POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


class Signature:
  """Parameters of a function, or of the `__init__` of a class.

  Args:
    func: the function or class. A built-in without a signature takes anything.
    num_leading: number of positional parameters before those of the term, such as the environment.
  """

  def __init__(self, func: Callable[..., Any], num_leading: int) -> None:
    parameters = _parameters(func)
    kinds = {p.kind for p in parameters}
    self.leading = [p.name for p in parameters if p.kind in _POSITIONAL][:num_leading]
    self.takes_more_positional = inspect.Parameter.VAR_POSITIONAL in kinds
    self._takes_any_name = inspect.Parameter.VAR_KEYWORD in kinds
    named = [p for p in parameters if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD) and p.name not in self.leading]
    self.names = [p.name for p in named]
    self.defaults = {p.name: p.default for p in named if p.default is not p.empty}
    self._hints = resolved_hints({p.name: p.annotation for p in named}, _namespace(func), {})

  def problems(self, given: Mapping[str, Any], *, complete: bool = True) -> Iterator[str]:
    """Yield the mistakes in parameters: unknown names, wrong types, and missing names if `complete`."""
    for name, value in given.items():
      if name not in self.names and not self._takes_any_name:
        yield unknown("parameter", name, self.names)
      elif not _has_tensors(value) and (wrong := named_problem(f"parameter '{name}'", value, self._hints.get(name))):
        yield f"{wrong}."
    missing = [name for name in self.names if complete and name not in {**self.defaults, **given}]
    if missing:
      yield f"missing parameter{'s' * (len(missing) > 1)} {', '.join(missing)}."

  def scalars(self, given: Mapping[str, Any], device: torch.device) -> dict[str, Scalar]:
    """Return the parameters annotated `float` or `tuple[float, ...]` as new scalars."""
    found: dict[str, Scalar] = {}
    for name, value in given.items():
      hints = _alternatives(self._hints.get(name))
      takes_tuple = any(typing.get_origin(hint) is tuple and float in typing.get_args(hint) for hint in hints)
      if float in hints and _is_number(value):
        found[name] = _scalar(value, device)
      elif takes_tuple and isinstance(value, tuple | list) and value and all(map(_is_number, value)):
        found[name] = tuple(_scalar(number, device) for number in value)
    return found


def fits_scalar(scalar: Scalar, value: Any) -> bool:
  """Return True for a number or 0-d tensor, or a tuple of as many as the scalar holds."""
  pairs = _pairs(scalar, value)
  return bool(pairs) and all(_is_number(new) or (isinstance(new, torch.Tensor) and new.dim() == 0) for _, new in pairs)


def write_scalar(scalar: Scalar, value: Any) -> None:
  """Write a value that fits into a scalar, in place."""
  for tensor, new in _pairs(scalar, value):
    tensor.fill_(new)


def _pairs(scalar: Scalar, value: Any) -> list[tuple[torch.Tensor, Any]]:
  if isinstance(scalar, torch.Tensor):
    return [(scalar, value)]
  same_length = isinstance(value, Sequence) and len(value) == len(scalar)
  return list(zip(scalar, value, strict=True)) if same_length else []


def _scalar(value: Any, device: torch.device) -> torch.Tensor:
  return torch.tensor(float(value), dtype=torch.float64, device=device)


def _parameters(func: Any) -> list[inspect.Parameter]:
  try:
    if isinstance(func, type):
      return list(inspect.signature(func.__init__).parameters.values())[1:]
    return list(inspect.signature(func).parameters.values())
  except (ValueError, TypeError):
    return list(inspect.signature(lambda *args, **kwargs: None).parameters.values())


def _namespace(func: Any) -> dict[str, Any]:
  """Return the names that the annotations of a function, or of the `__init__` of a class, can use."""
  while isinstance(func, functools.partial):
    func = func.func
  if isinstance(func, type):
    func = func.__init__
  elif not inspect.isroutine(func):
    func = type(func).__call__
  return getattr(inspect.unwrap(func), "__globals__", {})


def _alternatives(hint: Any) -> tuple[Any, ...]:
  """Return the types of a union, without their constraints."""
  origin, args = typing.get_origin(hint), typing.get_args(hint)
  if origin is typing.Annotated:
    return _alternatives(args[0])
  if origin in (typing.Union, types.UnionType):
    return tuple(part for arg in args for part in _alternatives(arg))
  return (hint,)


def _has_tensors(value: Any) -> bool:
  """Return True for a scalar on the device, or a sequence with one, which cannot be checked on the host."""
  return any(isinstance(part, torch.Tensor) for part in (value if isinstance(value, list | tuple) else (value,)))


def _is_number(value: Any) -> bool:
  return isinstance(value, Real) and not isinstance(value, bool)
