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
from typing import Any, Literal, Union

from mjlab_core import nearest

from mjlab.cli._errors import UsageError

_SCALARS = (bool, int, float, str)
_NONE = type(None)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flag:
  """One settable value of a configuration."""

  name: str
  """Without the two hyphens: "env.rewards.foot-slip.weight"."""
  path: tuple[Any, ...]
  """Attribute names, keys and indices from the root."""
  value: Any
  """Present value."""
  kinds: tuple[Any, ...]
  """Types it may have: scalars, Literal, enums, tuple[...] or list[...], NoneType."""
  owner: type | None
  """Dataclass that has it as a field."""
  is_part: bool = False
  """A whole term or part, which can only be switched off."""

  @property
  def type_name(self) -> str:
    """What to write after it."""
    return "|".join(dict.fromkeys(_type_name(kind) for kind in self.kinds))


def flags(config: Any, prefix: str) -> list[Flag]:
  """All flags of a configuration, in the order of its fields."""
  return list(_walk(config, (prefix,), Any, None))


def _walk(value: Any, path: tuple[Any, ...], annotation: Any, owner: type | None) -> Iterator[Flag]:
  name = ".".join(str(part).replace("_", "-") for part in path)
  if dataclasses.is_dataclass(value) and not isinstance(value, type):
    if _NONE in _members(annotation):
      yield Flag(name=name, path=path[1:], value=value, kinds=(_NONE,), owner=owner, is_part=True)
    hints = _hints(type(value))
    for field in dataclasses.fields(value):
      if field.init and not field.name.startswith("_"):
        kind = hints.get(field.name, Any)
        yield from _walk(getattr(value, field.name), (*path, field.name), kind, type(value))
  elif isinstance(value, Mapping):
    item_kind = _mapping_item(annotation)
    for key, item in value.items():
      if isinstance(key, (str, int)):
        yield from _walk(item, (*path, key), item_kind, None)
  elif isinstance(value, (tuple, list)) and not all(_is_plain(item) for item in value):
    for index, item in enumerate(value):
      yield from _walk(item, (*path, index), Any, None)
  else:
    kinds = _kinds(annotation, value)
    if kinds:
      yield Flag(name=name, path=path[1:], value=value, kinds=kinds, owner=owner)


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


def _mapping_item(annotation: Any) -> Any:
  for member in _members(annotation):
    arguments = typing.get_args(member)
    if len(arguments) == 2 and isinstance(typing.get_origin(member), type):
      return arguments[1]
  return Any


def _kinds(annotation: Any, value: Any) -> tuple[Any, ...]:
  """Types a flag may take: those of its annotation that can be typed in, else that of its value."""
  found = [member for member in _members(annotation) if _is_typable(member)]
  if not any(kind is not _NONE for kind in found):
    found = [*_kinds_of(value), *found]
  is_present = any(_fits(value, kind) for kind in found)
  return tuple(found) if any(kind is not _NONE for kind in found) and is_present else ()


def _is_typable(kind: Any) -> bool:
  if kind in (*_SCALARS, _NONE) or typing.get_origin(kind) is Literal:
    return True
  if isinstance(kind, type) and issubclass(kind, enum.Enum):
    return True
  return typing.get_origin(kind) in (tuple, list) and all(
    part is Ellipsis or all(_is_typable(member) for member in _members(part)) for part in typing.get_args(kind)
  )


def _kinds_of(value: Any) -> list[Any]:
  if isinstance(value, enum.Enum):
    return [type(value)]
  for kind in _SCALARS:
    if type(value) is kind:
      # An untyped parameter that happens to be a whole number may well take a fraction.
      return [int, float] if kind is int else [kind]
  if isinstance(value, (tuple, list)) and value:
    parts = [_kinds_of(item) for item in value]
    if not all(parts):
      return []
    kinds: Any = tuple(Union[tuple(part)] for part in parts)  # noqa: UP007
    if isinstance(value, list):
      return [list.__class_getitem__(kinds[0])]
    # The length of a row of numbers means something, that of a row of names does not.
    return [tuple.__class_getitem__((kinds[0], ...) if kinds[0] is str else kinds)]
  return []


def _fits(value: Any, kind: Any) -> bool:
  origin = typing.get_origin(kind)
  if origin is Literal:
    return value in typing.get_args(kind)
  if origin is not None:
    return isinstance(value, (tuple, list))
  return isinstance(value, (int, float)) if kind is float else isinstance(value, kind)


def override(config: Any, prefix: str, given: Sequence[tuple[str, list[str]]]) -> Any:
  """A copy of `config` with the given flags set.

  Args:
    config: Configuration; not changed.
    prefix: First part of the flags that mean it, such as "env"; others are passed over.
    given: Flags as typed, without hyphens, each with the words after it.

  Raises:
    UsageError: No such flag (the message names the nearest), or a value that does not fit.
  """
  for typed, words in given:
    if typed.partition(".")[0] != prefix:
      continue
    known = {flag.name: flag for flag in flags(config, prefix)}
    name = typed.replace("_", "-")
    parent, _, last = name.rpartition(".")
    positive = f"{parent}.{last.removeprefix('no-')}"
    if name in known:
      config = _replace(config, known[name].path, _parse(known[name], words))
    elif last.startswith("no-") and positive in known and bool in known[positive].kinds and not words:
      config = _replace(config, known[positive].path, False)
    else:
      raise UsageError(unknown_flag(name, list(known)))
  return config


def unknown_flag(name: str, known: Sequence[str]) -> str:
  """What to say about a flag that does not exist."""
  inside = [flag for flag in known if flag.startswith(f"{name}.")]
  if inside:
    return f"--{name}: not a single value; its options are {_list(inside)}"
  # A part of the same name elsewhere is likelier meant than a name that merely looks alike.
  last = name.rpartition(".")[2]
  close = nearest(name, [flag for flag in known if flag.rpartition(".")[2] == last] or known)
  return f"--{name}: no such option." + (f" Did you mean --{close[0]}?" if close else "")


def _list(names: Sequence[str]) -> str:
  shown = [f"--{name}" for name in names[:3]]
  return ", ".join(shown) + (", ..." if len(names) > 3 else "")


def _replace(value: Any, path: tuple[Any, ...], new: Any) -> Any:
  if not path:
    return new
  head, rest = path[0], path[1:]
  if dataclasses.is_dataclass(value):
    changed = copy.copy(value)
    # Also for frozen classes; their checks run again when the environment is built.
    object.__setattr__(changed, head, _replace(getattr(value, head), rest, new))
    return changed
  if isinstance(value, tuple):
    return tuple(_replace(item, rest, new) if i == head else item for i, item in enumerate(value))
  changed = copy.copy(value)
  changed[head] = _replace(value[head], rest, new)
  return changed


def _parse(flag: Flag, words: list[str]) -> Any:
  for kind in sorted(flag.kinds, key=lambda kind: _order(kind, words)):
    try:
      return _convert(words, kind)
    except (ValueError, SyntaxError):
      continue
  got = " ".join(words) if words else "nothing"
  raise UsageError(f"--{flag.name}: expected {flag.type_name}, got {got}")


def _order(kind: Any, words: list[str]) -> int:
  """Strict types first: a word is read as a string only where it is nothing else."""
  if typing.get_origin(kind) in (tuple, list):
    return 7 if len(words) == 1 and words[0][:1] not in ("(", "[") else 1
  order: dict[Any, int] = {_NONE: 0, bool: 2, int: 3, float: 4, str: 6}
  return order.get(kind, 1)


def _convert(words: list[str], kind: Any) -> Any:
  origin = typing.get_origin(kind)
  if origin in (tuple, list):
    return origin(_convert_items(words, kind))
  if kind is bool and not words:
    return True
  if len(words) != 1:
    raise ValueError("one word is wanted")
  return _convert_word(words[0], kind)


def _convert_word(word: str, kind: Any) -> Any:
  if typing.get_origin(kind) is Literal:
    for choice in typing.get_args(kind):
      if str(choice) == word:
        return choice
    raise ValueError(word)
  if kind is _NONE:
    if word.lower() == "none":
      return None
    raise ValueError(word)
  if kind is bool:
    return {"true": True, "false": False}[word.lower()] if word.lower() in ("true", "false") else _fail(word)
  if kind is int:
    try:
      return int(word)
    except ValueError:
      number = float(word)
      return int(number) if number.is_integer() else _fail(word)
  if isinstance(kind, type) and issubclass(kind, enum.Enum):
    return kind[word] if word in kind.__members__ else _fail(word)
  return kind(word)


def _fail(word: str) -> Any:
  raise ValueError(word)


def _convert_items(words: list[str], kind: Any) -> list[Any]:
  if len(words) == 1 and words[0][:1] in ("(", "["):
    items: list[Any] = list(ast.literal_eval(words[0]))
  elif len(words) == 1 and "," in words[0]:
    items = [word.strip() for word in words[0].split(",") if word.strip()]
  else:
    items = list(words)
  arguments = typing.get_args(kind)
  is_open = typing.get_origin(kind) is list or (len(arguments) == 2 and arguments[1] is Ellipsis)
  kinds = [arguments[0]] * len(items) if is_open else list(arguments)
  if len(kinds) != len(items):
    raise ValueError("wrong number of items")
  return [_convert_item(item, part) for item, part in zip(items, kinds, strict=True)]


def _convert_item(item: Any, annotation: Any) -> Any:
  members = _members(annotation)
  words = [str(item)]
  for kind in sorted(members, key=lambda kind: _order(kind, words)):
    try:
      return _convert(words, kind)
    except (ValueError, SyntaxError):
      continue
  raise ValueError(str(item))


def _type_name(kind: Any) -> str:
  origin = typing.get_origin(kind)
  if origin is Literal:
    return "|".join(str(choice) for choice in typing.get_args(kind))
  if origin in (tuple, list):
    arguments = typing.get_args(kind)
    if origin is list or (len(arguments) == 2 and arguments[1] is Ellipsis):
      return f"{_union_name(arguments[0])}..."
    return " ".join(_union_name(part) for part in arguments)
  if kind is _NONE:
    return "None"
  if kind is bool:
    return "true|false"
  if isinstance(kind, type) and issubclass(kind, enum.Enum):
    return "|".join(kind.__members__)
  return kind.__name__.upper()


def _union_name(annotation: Any) -> str:
  names = [_type_name(member) for member in _members(annotation)]
  return "FLOAT" if names == ["INT", "FLOAT"] else "|".join(names)


def describe(shown: Sequence[Flag]) -> str:
  """Help text of flags, grouped by the part of the configuration they are in."""
  groups: dict[str, list[str]] = {}
  for flag in shown:
    if flag.is_part:
      groups.setdefault(flag.name, []).append(f"  --{flag.name} None  (switches it off)")
      continue
    lines = groups.setdefault(flag.name.rpartition(".")[0], [])
    lines.append(f"  --{flag.name} {_types(flag)}  (default: {_shown(flag.value)})")
    about = _field_docs(flag.owner).get(flag.path[-1], "") if flag.owner is not None else ""
    if about:
      lines.append(f"      {about}")
  return "\n\n".join("\n".join([f"{group}:", *lines]) for group, lines in groups.items())


def _types(flag: Flag) -> str:
  return "FLOAT" if flag.type_name == "INT|FLOAT" else flag.type_name


def _shown(value: Any) -> str:
  if isinstance(value, enum.Enum):
    return value.name
  if isinstance(value, (tuple, list)):
    return " ".join(_shown(item) for item in value) or "empty"
  return repr(value) if isinstance(value, str) and not value else str(value)


@functools.cache
def _field_docs(cls: type) -> dict[str, str]:
  """First line of the string under each field of a dataclass and its bases."""
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
        docs[field.target.id] = text.value.value.strip().splitlines()[0]
  return docs
