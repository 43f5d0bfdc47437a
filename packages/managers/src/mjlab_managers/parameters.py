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
from mjlab_core import nearest
from mjlab_core.constraints import named_problem

Scalar = torch.Tensor | tuple[torch.Tensor, ...]
"""Number, or tuple of numbers, as 0-d float64 tensors on the device."""

_NAMED = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
_POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


class Signature:
  """Parameters of a function, or of the `__init__` of a class.

  Args:
    func: the function or class.
    num_leading: number of positional parameters before those of the term, such as the environment.
  """

  def __init__(self, func: Callable[..., Any], num_leading: int) -> None:
    found = _parameters(func)
    self.known = found is not None
    """False for built-ins without a signature, which cannot be checked."""
    parameters = found or []
    positional = [p for p in parameters if p.kind in _POSITIONAL]
    self.leading = [p.name for p in positional[:num_leading]]
    self.takes_more_positional = any(p.kind is inspect.Parameter.VAR_POSITIONAL for p in parameters)
    self._takes_any_name = not self.known or any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters)
    named = {p.name: p for p in parameters if p.kind in _NAMED and p not in positional[:num_leading]}
    self.names = list(named)
    self.defaults = {name: p.default for name, p in named.items() if p.default is not p.empty}
    self.hints = {name: _resolved(p.annotation, func) for name, p in named.items()}

  def problems(self, given: Mapping[str, Any], *, complete: bool = True) -> Iterator[str]:
    """Yield the mistakes in parameters: unknown names, wrong types, and missing names if `complete`."""
    missing = [name for name in self.names if name not in self.defaults and name not in given] if complete else []
    for name, value in given.items():
      if name not in self.names and not self._takes_any_name:
        close = nearest(name, self.names)
        hint = f" Nearest: {', '.join(close)}." if close else ""
        yield f"unknown parameter '{name}'.{hint} Given: {_listed(given)}; possible: {_listed(self.names)}."
      elif not _has_tensors(value) and (wrong := named_problem(f"parameter '{name}'", value, self.hints.get(name))):
        yield f"{wrong}."
    if missing:
      yield (
        f"missing parameter{'s' * (len(missing) > 1)} {', '.join(missing)}. Given: {_listed(given)}; "
        f"possible: {_listed(self.names)}."
      )

  def scalar(self, name: str, value: Any, device: torch.device) -> Scalar | None:
    """Return a parameter annotated `float` or `tuple[float, ...]` as a new scalar; None for all others."""
    hints = _alternatives(self.hints.get(name))
    if _is_number(value) and float in hints:
      return torch.tensor(float(value), dtype=torch.float64, device=device)
    tuples = any(typing.get_origin(hint) is tuple and float in typing.get_args(hint) for hint in hints)
    if tuples and isinstance(value, tuple | list) and value and all(map(_is_number, value)):
      return tuple(torch.tensor(float(number), dtype=torch.float64, device=device) for number in value)
    return None


def fits_scalar(scalar: Scalar, value: Any) -> bool:
  """Return True for a number or 0-d tensor, or a tuple of as many as the scalar holds."""
  pairs = _pairs(scalar, value)
  return bool(pairs) and all(_is_number(new) or (isinstance(new, torch.Tensor) and new.dim() == 0) for _, new in pairs)


def write_scalar(scalar: Scalar, value: Any) -> None:
  """Write a value that fits into a scalar, in place."""
  for tensor, new in _pairs(scalar, value):
    if isinstance(new, torch.Tensor):
      tensor.copy_(new)
    else:
      tensor.fill_(float(new))


def _pairs(scalar: Scalar, value: Any) -> list[tuple[torch.Tensor, Any]]:
  if isinstance(scalar, torch.Tensor):
    return [(scalar, value)]
  same_length = isinstance(value, Sequence) and len(value) == len(scalar)
  return list(zip(scalar, value, strict=True)) if same_length else []


def _parameters(func: Any) -> list[inspect.Parameter] | None:
  try:
    if isinstance(func, type):
      return list(inspect.signature(func.__init__).parameters.values())[1:]
    return list(inspect.signature(func).parameters.values())
  except (ValueError, TypeError):
    return None


def _resolved(annotation: Any, func: Any) -> Any:
  """Return an annotation as a type, or None if it cannot be evaluated."""
  if not isinstance(annotation, str):
    return annotation
  while isinstance(func, functools.partial):
    func = func.func
  if isinstance(func, type):
    func = func.__init__
  elif not hasattr(func, "__globals__") and not hasattr(func, "__func__"):
    func = vars(type(func)).get("__call__", func)
  try:
    return eval(annotation, getattr(inspect.unwrap(func), "__globals__", {}))
  except Exception:
    return None


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


def _listed(names: Any) -> str:
  return ", ".join(names) or "none"
