"""Check of values against the declared types of dataclass fields, for values that come from a file."""

import dataclasses
import functools
import inspect
import re
import types
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from mjlab_core import printable
from mjlab_core.constraints import field_hints, field_problem

_SEQUENCES = (list, tuple, Sequence, Iterable, Collection)
_SETS = (set, frozenset)
_CONTAINERS = (dict, Mapping, *_SEQUENCES, *_SETS)


def field_problems(cls: type, values: Mapping[str, Any], prefix: str) -> Iterator[str]:
  """Yield one line for each value that does not fit the field of `cls` that it is for; names begin with `prefix`.

  A value equal to the field's default fits. Functions are compared with the signature that the field declares.
  """
  hints = field_hints(cls)
  defaults = {field.name: field.default for field in dataclasses.fields(cls)} if dataclasses.is_dataclass(cls) else {}
  is_term = {"func", "params"} <= hints.keys()
  for name, value in values.items():
    if value is None and defaults.get(name, value) is None:
      continue
    if is_term and name == "func" and get_origin(hints[name]) is Callable:
      yield from _term_problems(value, prefix + name)
    else:
      yield from problems(value, hints.get(name, Any), prefix + name)


def problems(value: Any, hint: Any, where: str) -> Iterator[str]:
  """Yield one line for each part of `value` that does not fit a type."""
  origin, arguments = get_origin(hint), get_args(hint)
  kind = origin or hint
  if origin is Annotated:
    found = list(problems(value, arguments[0], where))
    if not found and (problem := field_problem(value, hint)):
      found = [f"{where} {problem}"]
    yield from found
  elif origin is Literal or hint in (bool, float, int, str):
    if problem := field_problem(value, hint):
      yield f"{where} {problem}"
  elif origin in (Union, types.UnionType):
    arms = [list(problems(value, arm, where)) for arm in arguments if arm is not type(None) or value is None]
    if all(arms):
      yield from arms[0] if len(arms) == 1 else [_mismatch(value, hint, where)]
  elif kind is Callable:
    yield from callable_problems(value, arguments, where)
  elif isinstance(value, functools.partial):
    yield f"{where}: a partial may stand only in a field that is declared as a Callable; pass function and values apart"
  elif not _is_instance(value, kind, arguments):
    yield _mismatch(value, hint, where)
  else:
    for part, of_part, name in _parts(value, arguments if kind in _CONTAINERS else (), where):
      yield from problems(part, of_part, name)


def _is_instance(value: Any, kind: Any, arguments: tuple[Any, ...]) -> bool:
  if kind in _SETS:
    return isinstance(value, _SETS)
  if kind in _SEQUENCES:
    is_fixed = kind is tuple and arguments and arguments[-1] is not Ellipsis
    return isinstance(value, (list, tuple)) and (not is_fixed or len(value) == len(arguments))
  if kind is type:
    bound = get_origin(arguments[0]) or arguments[0] if arguments else object
    return isinstance(value, type) and (bound is Any or not isinstance(bound, type) or issubclass(value, bound))
  if kind is None:
    return value is None
  if not isinstance(kind, type) or kind in (Any, object) or getattr(kind, "_is_protocol", False):
    return True
  return isinstance(value, PurePath if issubclass(kind, PurePath) else kind)


def _parts(value: Any, arguments: tuple[Any, ...], where: str) -> Iterator[tuple[Any, Any, str]]:
  """Yield each part of a container with its type and its name; other values have no parts.

  Args:
    value: The value.
    arguments: Type arguments of its container; empty: parts of any type.
    where: Name of the value.
  """
  if isinstance(value, Mapping):
    of_key, of_item = arguments or (Any, Any)
    for key, item in value.items():
      yield key, of_key, f"{where} key"
      yield item, of_item, f"{where}.{key}" if isinstance(key, str) else f"{where}[{key!r}]"
  elif isinstance(value, (list, tuple, set, frozenset)):
    is_each = len(arguments) == len(value) and arguments[-1:] != (Ellipsis,)
    of_items = arguments if is_each else [(arguments or (Any,))[0]] * len(value)
    for i, (item, of_item) in enumerate(zip(value, of_items, strict=True)):
      yield item, of_item, f"{where}[{i}]"


def callable_problems(value: Any, arguments: tuple[Any, ...], where: str) -> Iterator[str]:
  """Yield a line if a callable does not have the signature of `Callable[parameters, result]`.

  Parameters and result are compared by name where the function annotates them, so that only a function made for such a
  field can stand in it. A partial needs a field that declares them.

  Args:
    value: Function, class, partial or callable object.
    arguments: Arguments of the `Callable` type; empty: any callable.
    where: Field, for the message.
  """
  if not callable(value):
    yield f"{where}: expected a function, got {_shown(value)}"
    return
  parameters: Any
  parameters, result = arguments or (Ellipsis, Any)
  if isinstance(value, functools.partial) and (parameters is Ellipsis) and not isinstance(result, type):
    yield f"{where}: a partial needs a field that declares what the function takes and returns"
    return
  expected: list[Any] = [] if parameters is Ellipsis else list(parameters)
  try:
    signature = inspect.signature(value)
    names = list(signature.bind(*expected).arguments) if parameters is not Ellipsis else []
  except (TypeError, ValueError) as error:
    yield f"{where}: {_name(value)} cannot be called there ({printable(error, 200)})"
    return
  for name, kind in zip(names, expected, strict=False):
    if not _agree(signature.parameters[name].annotation, kind):
      yield f"{where}: {_name(value)} takes {_text(signature.parameters[name].annotation)}, not {_text(kind)}"
  returned = value if isinstance(value, type) else signature.return_annotation
  if not _agree(returned, result):
    yield f"{where}: {_name(value)} returns {_text(returned)}, not {_text(result)}"


def _term_problems(value: Any, where: str) -> Iterator[str]:
  """Yield a line unless `value` is a term: a function of `env`, or a class made with it and then called."""
  if isinstance(value, functools.partial) and value.args:
    yield f"{where}: a partial of a term binds parameters by name only"
    return
  if not callable(value):
    yield f"{where}: expected a function or class, got {_shown(value)}"
    return
  is_class = isinstance(value, type)
  try:
    names = list(inspect.signature(value.__init__ if is_class else value).parameters)
  except (TypeError, ValueError) as error:
    yield f"{where}: {_name(value)} cannot be called there ({printable(error, 200)})"
    return
  is_called = not is_class or any("__call__" in vars(base) for base in value.__mro__)
  if not is_called or "env" not in names[: 3 if is_class else 1]:
    yield f"{where}: {_name(value)} is not a term: it does not take the environment first, as 'env'"


def _agree(annotation: Any, kind: Any) -> bool:
  """Compare the annotation of a function with a class, by name, because annotations are often unresolved text."""
  if annotation is inspect.Parameter.empty or isinstance(kind, TypeVar) or kind is Any:
    return True
  if kind is type(None):
    return annotation in (None, "None")
  if not isinstance(kind, type):
    return True
  names = {"Any"} | {base.__name__ for base in kind.__mro__ if base is not object}
  if isinstance(annotation, type):
    return annotation.__name__ in names or issubclass(annotation, kind)
  arms = re.sub(r"^Optional\[(.*)\]$", r"\1", _text(annotation)).split("|")
  return not names.isdisjoint(arm.partition("[")[0].strip(" '\"").rpartition(".")[2] for arm in arms)


def _mismatch(value: Any, hint: Any, where: str) -> str:
  return f"{where}: expected {_text(hint)}, got {_shown(value)}"


def _text(hint: Any) -> str:
  return hint.__qualname__ if isinstance(hint, type) else str(hint).replace("typing.", "")


def _name(value: Any) -> str:
  target = value.func if isinstance(value, functools.partial) else value
  return f"'{getattr(target, '__module__', '?')}:{getattr(target, '__qualname__', type(target).__name__)}'"


def _shown(value: Any) -> str:
  kind = type(value)
  return printable(repr(value), 60) if isinstance(value, (bool, int, float, str, type(None))) else kind.__qualname__
