"""JSON data of configurations, from which they are rebuilt equal to the last bit.

Data is written as data, functions and classes as names. `decode` names functions and classes and constructs dataclasses
of trusted packages. It calls nothing else.
"""

import dataclasses
import enum
import functools
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
from mjlab_core import printable
from mjlab_core.errors import ConfigError, FileError
from mjlab_core.names import check_name
from msgspec import Meta

from mjlab_rl.field_types import field_problems
from mjlab_rl.references import reference, resolve, resolve_enum

# JSON data: None, booleans, numbers, strings, lists and dictionaries of them.
Json: TypeAlias = Any

_KINDS: dict[str, Any] = {
  "$float": float,
  "$path": Path,
  "$slice": slice,
  "$range": range,
  "$tuple": tuple,
  "$set": set,
  "$frozenset": frozenset,
}
# Paths for output are never taken from a file.
_OUTPUT_FIELDS = ("output_dir",)


def encode(value: Any, where: str = "config") -> Json:
  """Return JSON data from which `decode` rebuilds `value`.

  Handles dataclasses (their init fields), named tuples, functions and classes with an importable name, partials, enums,
  tuples, lists, sets, dictionaries with any keys, slices, ranges, paths, NumPy arrays and scalars, infinities and NaN.

  Raises:
    ConfigError: Parts of it cannot be rebuilt; the message names each field, starting with `where`.
  """
  kind = type(value)
  if value is None or kind in (bool, int, str):
    return value
  if kind is float:
    return value if math.isfinite(value) else {"$float": repr(value)}
  if kind in (list, tuple, set, frozenset):
    items = _encode_each((f"{where}[{i}]", item) for i, item in enumerate(value))
    if kind in (set, frozenset):
      items.sort(key=json.dumps)
    return items if kind is list else {f"${kind.__name__}": items}
  if kind is dict:
    if all(type(key) is str and not key.startswith("$") for key in value):
      items = _encode_each((f"{where}.{key}", item) for key, item in value.items())
      return dict(zip(value, items, strict=True))
    return {"$dict": [[encode(key, where), encode(item, f"{where}[{key!r}]")] for key, item in value.items()]}
  if isinstance(value, (type, FunctionType, BuiltinFunctionType, MethodType)):
    return {"$ref": reference(value, where)}
  if isinstance(value, enum.Enum):
    return {"$enum": reference(kind, where), "name": value.name}
  if (names := _field_names(value)) is not None:
    fields = _encode_each((f"{where}.{name}", getattr(value, name)) for name in names)
    return {"$type": reference(kind, where), "fields": dict(zip(names, fields, strict=True))}
  if isinstance(value, functools.partial):
    parts = {"args": list(value.args), "keywords": value.keywords}
    return {"$partial": encode(value.func, where), **encode(parts, where)}
  if isinstance(value, (slice, range)):
    return {f"${kind.__name__}": [encode(item, where) for item in (value.start, value.stop, value.step)]}
  if isinstance(value, Path):
    return {"$path": str(value)}
  return _encode_foreign(value, where)


def _field_names(value: Any) -> Sequence[str] | None:
  """Return the fields of a dataclass or a named tuple; None for another value."""
  if dataclasses.is_dataclass(value):
    return [field.name for field in dataclasses.fields(value) if field.init]
  return getattr(value, "_fields", None) if isinstance(value, tuple) else None


def _encode_each(parts: Iterable[tuple[str, object]]) -> list[Json]:
  """Return the data of all parts, each given with its name; the problems of all are raised together."""
  done: list[Json] = []
  problems: list[str] = []
  for where, part in parts:
    try:
      done.append(encode(part, where))
    except ConfigError as error:
      problems += error.problems
  if problems:
    raise ConfigError(*problems)
  return done


def _encode_foreign(value: Any, where: str) -> Json:
  """Encode NumPy values, MuJoCo's enums and cached functions, recognised without importing their packages."""
  kind = type(value)
  if kind.__module__ == "numpy":
    tag = "$array" if kind.__name__ == "ndarray" else "$scalar"
    return {tag: encode(value.tolist(), where), "dtype": str(value.dtype), "shape": list(value.shape)}
  if kind.__module__ == "mujoco._enums":
    return {"$enum": f"{kind.__module__}:{kind.__qualname__}", "name": value.name}
  if callable(value):
    return {"$ref": reference(value, where)}
  remedy = "use plain values, dataclasses, or a function of a module that builds it"
  raise ConfigError(f"{where}: a {kind.__module__}.{kind.__qualname__} cannot be written to the run manifest; {remedy}")


_Dtype = Literal[
  "bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float16", "float32", "float64"
]
_Shape = list[Annotated[int, Meta(ge=0)]]
_Fields = dict[str, Any]
_Index = int | None
# Shape of each tagged value: type of its body, then the other keys with their types.
_SCHEMA: dict[str, tuple[Any, dict[str, Any]]] = {
  "$float": (Literal["nan", "inf", "-inf"], {}),
  "$tuple": (list[Any], {}),
  "$set": (list[Any], {}),
  "$frozenset": (list[Any], {}),
  "$dict": (list[tuple[Any, Any]], {}),
  "$slice": (tuple[_Index, _Index, _Index], {}),
  "$range": (tuple[int, int, int], {}),
  "$path": (str, {}),
  "$ref": (str, {}),
  "$enum": (str, {"name": str}),
  "$type": (str, {"fields": _Fields}),
  "$partial": (_Fields, {"args": list[Any], "keywords": _Fields}),
  "$array": (Any, {"dtype": _Dtype, "shape": _Shape}),
  "$scalar": (Any, {"dtype": _Dtype, "shape": _Shape}),
}
_NODES = {
  tag: msgspec.defstruct(
    tag[1:].title(), [("body", body), *keys.items()], forbid_unknown_fields=True, rename={"body": tag}
  )
  for tag, (body, keys) in _SCHEMA.items()
}


def decode(data: Json, where: str = "config") -> Any:
  """Rebuild what `encode` wrote.

  Imports modules of trusted packages by name and calls the generated constructors of their dataclasses. Functions are
  named, never called. A partial is only made where a field is declared as a callable, and not called either.

  Raises:
    FileError: The data has another form, names something outside trusted packages, or a class has no such field.
  """
  if isinstance(data, list):
    return [decode(item, f"{where}[{i}]") for i, item in enumerate(data)]
  if not isinstance(data, dict):
    return data
  tag = next((key for key in data if key.startswith("$")), None)
  if tag is None:
    return {key: decode(item, f"{where}.{key}") for key, item in data.items()}
  try:
    node: Any = msgspec.convert(data, _NODES[check_name("tag", printable(tag, 60), _NODES)])
    return _value(tag, node, where)
  except FileError:
    raise
  except (msgspec.ValidationError, TypeError, ValueError, OverflowError) as error:
    raise FileError(f"{where}: {printable(tag, 60)}: {printable(error, 300)}") from error


def _value(tag: str, node: Any, where: str) -> Any:
  """Rebuild one tagged value."""
  body = node.body
  match tag:
    case "$float" | "$path":
      return _KINDS[tag](body)
    case "$slice" | "$range":
      return _KINDS[tag](*body)
    case "$tuple" | "$set" | "$frozenset":
      return _KINDS[tag](decode(item, f"{where}[{i}]") for i, item in enumerate(body))
    case "$dict":
      return {decode(key, where): decode(item, f"{where}[{printable(key, 60)}]") for key, item in body}
    case "$ref":
      return resolve(body, where)
    case "$enum":
      return resolve_enum(body, node.name, where)
    case "$partial":
      if body.keys() != {"$ref"}:
        raise FileError(f"{where}: a partial needs the name of a function")
      args, keywords = decode(node.args, f"{where}.args"), decode(node.keywords, where)
      return functools.partial(resolve(body["$ref"], where), *args, **keywords)
    case "$type":
      return construct(resolve(body, where), node.fields, f"{where}.")
    case _:
      import numpy as np

      array = np.array(decode(body, where), dtype=node.dtype).reshape(node.shape)
      return array if tag == "$array" else array[()]


def construct(kind: Any, data: dict[str, Json], prefix: str) -> Any:
  """Construct a dataclass or named tuple by its generated constructor, from values that fit its fields.

  Args:
    kind: The class.
    data: Encoded values by field.
    prefix: Name of the value with a dot, for messages; empty for a whole file.

  Raises:
    MjlabError, TypeError, ValueError: The data does not fit.
  """
  known = getattr(kind, "__dataclass_fields__", None) or getattr(kind, "_fields", None)
  constructor = kind.__new__ if isinstance(kind, type) and issubclass(kind, tuple) else getattr(kind, "__init__", None)
  # Generated code has no file.
  if not isinstance(kind, type) or not known or not _is_generated(constructor):
    raise FileError(f"{prefix} {getattr(kind, '__qualname__', kind)} is not a dataclass")
  for name in data:
    check_name("field", printable(name, 60), known, kind.__qualname__)
  values = {name: None if name in _OUTPUT_FIELDS else decode(item, prefix + name) for name, item in data.items()}
  for problem in field_problems(kind, values, prefix):
    raise FileError(problem)
  return kind(**values)


def _is_generated(function: Any) -> bool:
  return getattr(getattr(function, "__code__", None), "co_filename", "").startswith("<string>")
