"""Every number, switch, word and tuple of a configuration is a flag: `--env.rewards.foot-slip.weight -0.2`.

A flag is the path to a value, underscores as hyphens; keys of dictionaries and indices of tuples are parts of it.
Setting one copies the objects along its path and nothing else, so functions, shared parts and unset values stay as they
are. A part or term that may be `None` is switched off with it.
"""

import ast
import copy
import dataclasses
import enum
import functools
import inspect
import itertools
import textwrap
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, TypeVar, Union

ConfigT = TypeVar("ConfigT")

_SCALARS = (bool, int, float, str)
_NONE = type(None)
# A whole term or part, which is there and can be taken away.
_PART: Any = Literal["on", "None"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flag:
  """One settable value of a configuration."""

  path: tuple[Any, ...]
  """Attribute names, keys and indices from the root."""
  value: Any
  """Present value; "on" for a whole part."""
  kind: Any
  """Type annotation of what it may be."""
  about: str = ""
  """What it means."""

  @functools.cached_property
  def parts(self) -> tuple[str, ...]:
    """The steps of its name. Dots at the ends of a pattern would be empty steps."""
    return tuple(str(part).strip(".").replace("_", "-") for part in self.path)

  @property
  def name(self) -> str:
    """Without the two hyphens: "env.rewards.foot-slip.weight"."""
    return ".".join(self.parts)


def flags(config: Any) -> list[Flag]:
  """All flags of a configuration, in the order of its fields; keys that differ in hyphens alone share the last's."""
  return list({flag.name: flag for flag in _walk(config, (), Any, "")}.values())


def with_values(config: ConfigT, values: Sequence[tuple[Flag, Any]]) -> ConfigT:
  """A copy of `config` in which these flags have these values."""
  # From the back: what is inside a part is set before the part is switched off.
  for flag, value in reversed(values):
    config = replaced(config, flag.path, None if flag.kind is _PART and value == "None" else value)
  return config


def replaced(config: Any, path: Sequence[Any], new: Any) -> Any:
  """A copy of `config` with another value at `path`; what is not on the path is shared with the original."""
  if not path:
    return new
  head, rest = path[0], path[1:]
  if isinstance(config, tuple):
    return tuple(replaced(item, rest, new) if i == head else item for i, item in enumerate(config))
  changed = copy.copy(config)
  if dataclasses.is_dataclass(config):
    # Also for frozen classes; their checks run again when the environment is built.
    object.__setattr__(changed, head, replaced(getattr(config, head), rest, new))
  else:
    changed[head] = replaced(config[head], rest, new)
  return changed


def _walk(value: Any, path: tuple[Any, ...], annotation: Any, about: str) -> Iterator[Flag]:
  if dataclasses.is_dataclass(value) and not isinstance(value, type):
    if _NONE in _members(annotation):
      yield Flag(path=path, value="on", kind=_PART, about="None switches it off.")
    hints, docs = _hints(type(value)), _field_docs(type(value))
    for field in dataclasses.fields(value):
      if field.init and not field.name.startswith("_"):
        kind, doc = hints.get(field.name, Any), docs.get(field.name, "")
        yield from _walk(getattr(value, field.name), (*path, field.name), kind, doc)
  elif isinstance(value, Mapping):
    for key, item in value.items():
      if isinstance(key, (str, int)):
        yield from _walk(item, (*path, key), _item_annotation(annotation), "")
  elif isinstance(value, (tuple, list)) and not _is_plain(value):
    for index, item in enumerate(value):
      yield from _walk(item, (*path, index), Any, "")
  elif (kind := _kind(annotation, value)) is not None:
    yield Flag(path=path, value=value, kind=kind, about=about)


def _is_plain(value: Any) -> bool:
  if isinstance(value, (tuple, list)):
    return all(_is_plain(item) for item in value)
  return value is None or isinstance(value, (*_SCALARS, enum.Enum))


@functools.cache
def _hints(cls: type) -> dict[str, Any]:
  try:
    return typing.get_type_hints(cls)
  except (NameError, TypeError, AttributeError):
    # Types that exist only for the type checker: the present values say enough.
    return {}


def _members(annotation: Any) -> list[Any]:
  origin = typing.get_origin(annotation)
  if origin in (Union, types.UnionType):
    return [member for part in typing.get_args(annotation) for member in _members(part)]
  if origin is Sequence:
    return [tuple.__class_getitem__((*typing.get_args(annotation), ...))]
  return [annotation]


def _item_annotation(annotation: Any) -> Any:
  for member in _members(annotation):
    arguments = typing.get_args(member)
    if len(arguments) == 2 and isinstance(typing.get_origin(member), type):
      return arguments[1]
  return Any


def _kind(annotation: Any, value: Any) -> Any:
  """The part of an annotation that can be typed in, or else the type of the value; None where there is neither."""
  kinds = [member for member in _members(annotation) if _is_typable(member)]
  if kinds in ([], [_NONE]) or not any(_fits(value, kind) for kind in kinds):
    found = _kind_of(value)
    if found is None:
      return None
    kinds.insert(0, found)
  # The first that fits wins, and every word is a string.
  kinds.sort(key=lambda kind: str in (kind, *typing.get_args(kind)))
  return Union[tuple(kinds)]  # noqa: UP007


def _is_typable(kind: Any) -> bool:
  if kind in (*_SCALARS, _NONE) or typing.get_origin(kind) is Literal:
    return True
  if isinstance(kind, type) and issubclass(kind, enum.Enum):
    return True
  return typing.get_origin(kind) in (tuple, list) and all(
    part is Ellipsis or all(_is_typable(member) for member in _members(part)) for part in typing.get_args(kind)
  )


def _fits(value: Any, kind: Any) -> bool:
  origin = typing.get_origin(kind)
  if origin is Literal:
    return value in typing.get_args(kind)
  if kind is float:
    return isinstance(value, (int, float))
  return isinstance(value, origin or kind)


def _kind_of(value: Any) -> Any:
  if isinstance(value, enum.Enum):
    return type(value)
  if type(value) in _SCALARS:
    # An untyped parameter that happens to be a whole number may well take a fraction.
    return int | float if type(value) is int else type(value)
  if isinstance(value, (tuple, list)) and value:
    parts = [_kind_of(item) for item in value]
    if None in parts:
      return None
    if isinstance(value, list):
      return list.__class_getitem__(parts[0])
    # The length of a row of numbers means something, that of a row of names does not.
    return tuple.__class_getitem__((str, ...) if parts[0] is str else tuple(parts))
  return None


@functools.cache
def _field_docs(cls: type) -> dict[str, str]:
  """First paragraph of the string under each field of a dataclass and its bases."""
  docs: dict[str, str] = {}
  for base in reversed(cls.__mro__):
    if not dataclasses.is_dataclass(base):
      continue
    try:
      tree = ast.parse(textwrap.dedent(inspect.getsource(base)))
    except (OSError, TypeError, SyntaxError):
      continue
    body = typing.cast(ast.ClassDef, tree.body[0]).body
    for field, text in itertools.pairwise(body):
      if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
        continue
      if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant) and isinstance(text.value.value, str):
        docs[field.target.id] = " ".join(text.value.value.partition("\n\n")[0].split())
  return docs
