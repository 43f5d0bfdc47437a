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
from typing import Any, TypeAlias

from mjlab_core import printable
from mjlab_core.errors import ConfigError, FileError
from mjlab_core.names import check_name

from mjlab_rl.runs.field_types import field_problems
from mjlab_rl.runs.references import reference, resolve, resolve_enum

# JSON data: None, booleans, numbers, strings, lists and dictionaries of them.
Json: TypeAlias = Any

_DTYPES = "bool int8 int16 int32 int64 uint8 uint16 uint32 uint64 float16 float32 float64".split()
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


def decode(data: Json, where: str = "config") -> Any:
  """Rebuild what `encode` wrote.

  Imports modules of trusted packages by name and calls the generated constructors of their dataclasses. Functions are
  named, never called. A partial is only made where a field is declared as a callable, and not called either.

  Raises:
    FileError: The data has another form, names something outside trusted packages, or a class has no such field.
  """
  try:
    return _value(data, where)
  except FileError:
    raise
  except (TypeError, ValueError, OverflowError) as error:
    raise FileError(f"{where}: {printable(next(iter(data)), 60)}: {printable(error, 300)}") from error


def _value(data: Json, where: str) -> Any:
  match data:
    case list():
      return [decode(item, f"{where}[{i}]") for i, item in enumerate(data)]
    case {"$float": "nan" | "inf" | "-inf" as text}:
      return float(text)
    case {"$tuple": list(items)}:
      return tuple(decode(items, where))
    case {"$set": list(items)}:
      return set(decode(items, where))
    case {"$frozenset": list(items)}:
      return frozenset(decode(items, where))
    case {"$dict": list(items)}:
      return {decode(key, where): decode(item, f"{where}[{printable(key, 60)}]") for key, item in items}
    case {"$slice": [start, stop, step]}:
      return slice(start, stop, step)
    case {"$range": [start, stop, step]}:
      return range(start, stop, step)
    case {"$path": path}:
      return Path(path)
    case {"$ref": name}:
      return resolve(name, where)
    case {"$enum": name, "name": str(member)}:
      return resolve_enum(name, member, where)
    case {"$type": name, "fields": dict(fields)}:
      return construct(resolve(name, where), fields, f"{where}.")
    case {"$partial": {"$ref": name}, "args": [*args], "keywords": dict(keywords)}:
      return functools.partial(resolve(name, where), *decode(args, f"{where}.args"), **decode(keywords, where))
    case {"$array": items, "dtype": dtype, "shape": list(shape)} if dtype in _DTYPES:
      return _array(decode(items, where), dtype).reshape(shape)
    case {"$scalar": item, "dtype": dtype} if dtype in _DTYPES:
      return _array(decode(item, where), dtype)[()]
    case dict():
      for key in data:
        if key.startswith("$"):
          raise ValueError("unknown or malformed value")
      return {key: decode(item, f"{where}.{key}") for key, item in data.items()}
  return data


def _array(data: Any, dtype: str) -> Any:
  import numpy as np

  return np.array(data, dtype=dtype)


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
