"""JSON data checked against dataclasses and built into them."""

import contextlib
import dataclasses
import math
import types
import typing
from typing import Any, Literal

from mjlab_deploy.errors import DeployError, check_known

_NAMES = {str: "string", bool: "boolean", int: "integer", float: "number", tuple: "array"}
"""Names of types in JSON; others are objects."""


def decode(kind: Any, data: Any, where: str = "") -> Any:
  """Return JSON data as a value of a type: a dataclass, or what its fields are made of.

  Raises:
    DeployError: The data does not fit the type; the message names the place.
  """
  origin, args = typing.get_origin(kind), typing.get_args(kind)
  if origin in (typing.Union, types.UnionType):
    # None comes first, so that the error is that of another kind.
    *others, last = sorted(args, key=lambda kind: kind is not types.NoneType)
    for other in others:
      with contextlib.suppress(DeployError):
        return decode(other, data, where)
    return decode(last, data, where)
  if dataclasses.is_dataclass(kind) and isinstance(data, dict):
    return _decode_object(kind, data, where)
  if origin is dict and isinstance(data, dict):
    return {key: decode(args[1], value, f"{where}.{key}") for key, value in data.items()}
  if origin is tuple and isinstance(data, list):
    each = args[:1] * len(data) if args[-1] is ... else args
    if len(each) == len(data):
      return tuple(decode(part, item, f"{where}[{i}]") for i, (part, item) in enumerate(zip(each, data, strict=True)))
  if kind is float and isinstance(data, int | float) and not isinstance(data, bool) and math.isfinite(data):
    return float(data)
  if kind is Any or (kind is not float and type(data) is kind) or (origin is Literal and data in args):
    return data
  wanted = " or ".join(map(repr, args)) if origin is Literal else _NAMES.get(origin or kind, "object")
  raise DeployError(f"{where or 'it'} must be {wanted}, got {str(data)[:60]!r}")


def _decode_object(kind: Any, data: dict[str, Any], where: str) -> Any:
  hints, here = typing.get_type_hints(kind), f"{where}: " if where else ""
  for name in data:
    check_known(f"{here}field", name, hints)
  for field in dataclasses.fields(kind):
    if field.default is dataclasses.MISSING is field.default_factory:
      check_known(f"{here}required field", field.name, data)
  prefix = f"{where}." if where else ""
  return kind(**{name: decode(hints[name], value, prefix + name) for name, value in data.items()})
