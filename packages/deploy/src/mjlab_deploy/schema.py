"""Dataclasses as a JSON schema, and JSON checked against it."""

import contextlib
import dataclasses
import math
import types
import typing
from typing import Any, Literal

from mjlab_deploy.errors import DeployError, check_known


def schema(kind: Any) -> dict[str, Any]:
  """Return the JSON schema (draft 2020-12) of a type: a dataclass, or what its fields are made of."""
  if kind is Any:
    return {}
  if dataclasses.is_dataclass(kind):
    return {
      "type": "object",
      "properties": {name: schema(hint) for name, hint in typing.get_type_hints(kind).items()},
      "required": _required(kind),
      "additionalProperties": False,
    }
  origin, args = typing.get_origin(kind), typing.get_args(kind)
  if origin is Literal:
    return {"enum": list(args)}
  if origin in (typing.Union, types.UnionType):
    return {"anyOf": [schema(arg) for arg in args]}
  if origin is dict:
    return {"type": "object", "additionalProperties": schema(args[1])}
  if origin is tuple and args[1:] == (...,):
    return {"type": "array", "items": schema(args[0])}
  if origin is tuple:
    return {"type": "array", "prefixItems": [schema(arg) for arg in args], "minItems": len(args), "items": False}
  return {"type": {str: "string", bool: "boolean", int: "integer", float: "number", types.NoneType: "null"}[kind]}


def decode(kind: Any, data: Any, where: str = "") -> Any:
  """Return JSON data as a value of the type whose `schema` it follows.

  Raises:
    DeployError: The data does not follow the schema; the message names the place.
  """
  origin, args = typing.get_origin(kind), typing.get_args(kind)
  if origin in (typing.Union, types.UnionType):
    return _decode_union(args, data, where)
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
  wanted = " or ".join(map(repr, args)) if origin is Literal else schema(kind).get("type", "a value")
  raise DeployError(f"{where or 'it'} must be {wanted}, got {str(data)[:60]!r}")


def _decode_object(kind: Any, data: dict[str, Any], where: str) -> Any:
  hints, here = typing.get_type_hints(kind), f"{where}: " if where else ""
  for name in data:
    check_known(f"{here}field", name, hints)
  for name in _required(kind):
    check_known(f"{here}required field", name, data)
  prefix = f"{where}." if where else ""
  return kind(**{name: decode(hints[name], value, prefix + name) for name, value in data.items()})


def _decode_union(kinds: tuple[Any, ...], data: Any, where: str) -> Any:
  if data is None and types.NoneType in kinds:
    return None
  *others, last = (kind for kind in kinds if kind is not types.NoneType)
  for kind in others:
    with contextlib.suppress(DeployError):
      return decode(kind, data, where)
  return decode(last, data, where)


def _required(kind: Any) -> list[str]:
  """Return the names of the fields of a dataclass that have no default."""
  missing = dataclasses.MISSING
  return [item.name for item in dataclasses.fields(kind) if item.default is missing is item.default_factory]
