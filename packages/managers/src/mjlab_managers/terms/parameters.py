"""Parameters of terms: signatures, checks of given values, and numbers as scalars on the device."""

from __future__ import annotations

import functools
import inspect
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from numbers import Real
from typing import Any

import torch
from mjlab_core import unknown
from mjlab_core.constraints import named_problem, resolved_hints

_POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


class Signature:
  """Parameters of a function, or of the `__init__` of a class.

  Args:
    func: the function or class. A built-in without a signature takes anything.
    masked: a function takes the worlds to act on after the environment.
  """

  def __init__(self, func: Callable[..., Any], *, masked: bool) -> None:
    parameters = _parameters(func)
    kinds = {p.kind for p in parameters}
    self.leading = [p.name for p in parameters if p.kind in _POSITIONAL]
    del self.leading[1 + (masked and not isinstance(func, type)) :]
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
      elif isinstance(value, torch.Tensor):
        # A number on the device, which cannot be checked on the host.
        continue
      elif wrong := named_problem(f"parameter '{name}'", value, self._hints.get(name)):
        yield f"{wrong.removesuffix('.')}."
    missing = [name for name in self.names if complete and name not in {**self.defaults, **given}]
    if missing:
      yield f"missing parameter{'s' * (len(missing) > 1)} {', '.join(missing)}."

  def scalars(self, given: Mapping[str, Any], device: torch.device) -> dict[str, torch.Tensor]:
    """Return the numbers among the parameters annotated `float` as new 0-d float64 tensors."""
    return {
      name: torch.tensor(float(value), dtype=torch.float64, device=device)
      for name, value in given.items()
      if is_number(value) and _allows_float(self._hints.get(name))
    }


def is_number(value: Any) -> bool:
  """Return True for a number that is not a bool."""
  return isinstance(value, Real) and not isinstance(value, bool)


def _parameters(func: Any) -> list[inspect.Parameter]:
  try:
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


def _allows_float(hint: Any) -> bool:
  if typing.get_origin(hint) in (typing.Annotated, typing.Union, types.UnionType):
    return any(map(_allows_float, typing.get_args(hint)))
  return hint is float
