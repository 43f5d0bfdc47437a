"""Dataclasses as a JSON schema, and JSON checked against it."""

import dataclasses
import math
import types
import typing
from typing import Any, Literal

from mjlab_deploy.errors import DeployError, check_known

_MAX_ITEMS = 100_000
_MAX_DEPTH = 12


def schema(kind: Any) -> dict[str, Any]:
  """Return the JSON schema (draft 2020-12) of a type: a dataclass, or what its fields are made of."""
  if kind is Any:
    return {}
  if dataclasses.is_dataclass(kind):
    hints, fields = typing.get_type_hints(kind), dataclasses.fields(kind)
    return {
      "type": "object",
      "properties": {field.name: schema(hints[field.name]) for field in fields},
      "required": [field.name for field in fields if _is_required(field)],
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
    return {"type": "array", "items": schema(args[0]), "maxItems": _MAX_ITEMS}
  if origin is tuple:
    return {"type": "array", "prefixItems": [schema(arg) for arg in args], "minItems": len(args), "items": False}
  return {"type": {str: "string", bool: "boolean", int: "integer", float: "number", types.NoneType: "null"}[kind]}


def decode(kind: Any, data: Any, where: str = "", depth: int = 0) -> Any:
  """Return JSON data as a value of the type whose `schema` it follows.

  Raises:
    DeployError: The data does not follow the schema; the message names the place.
  """
  if depth > _MAX_DEPTH:
    raise DeployError(f"{where}: nested too deeply")
  if kind is Any:
    return data
  if dataclasses.is_dataclass(kind):
    return _decode_object(kind, data, where, depth)
  origin, args = typing.get_origin(kind), typing.get_args(kind)
  if origin is Literal and isinstance(data, str) and data in args:
    return data
  if origin in (typing.Union, types.UnionType):
    return _decode_union(args, data, where, depth)
  if origin is dict and isinstance(data, dict) and len(data) <= _MAX_ITEMS:
    return {key: decode(args[1], value, f"{where}.{key}", depth + 1) for key, value in data.items()}
  if origin is tuple and isinstance(data, list) and len(data) <= _MAX_ITEMS:
    each = [args[0]] * len(data) if args[1:] == (...,) else list(args)
    if len(each) == len(data):
      parts = zip(each, data, strict=True)
      return tuple(decode(part, item, f"{where}[{i}]", depth + 1) for i, (part, item) in enumerate(parts))
  if origin is None and _is_scalar(kind, data):
    scalar: Any = data
    return float(scalar) if kind is float else scalar
  wanted = " or ".join(map(repr, args)) if origin is Literal else schema(kind).get("type", "a value")
  raise DeployError(f"{where or 'it'} must be {wanted}, got {str(data)[:60]!r}")


def _decode_object(kind: Any, data: Any, where: str, depth: int) -> Any:
  if not isinstance(data, dict):
    raise DeployError(f"{where or 'it'} must be an object, got {str(data)[:60]!r}")
  hints, fields = typing.get_type_hints(kind), {field.name: field for field in dataclasses.fields(kind)}
  here = f"{where}: " if where else ""
  for name in data:
    check_known(f"{here}field", name, fields)
  for name, field in fields.items():
    if _is_required(field):
      check_known(f"{here}required field", name, data)
  prefix = f"{where}." if where else ""
  return kind(**{name: decode(hints[name], value, prefix + name, depth + 1) for name, value in data.items()})


def _decode_union(kinds: tuple[Any, ...], data: Any, where: str, depth: int) -> Any:
  if data is None and types.NoneType in kinds:
    return None
  others = [kind for kind in kinds if kind is not types.NoneType]
  for kind in others[:-1]:
    try:
      return decode(kind, data, where, depth + 1)
    except DeployError:
      continue
  return decode(others[-1], data, where, depth + 1)


def _is_scalar(kind: Any, data: Any) -> bool:
  if kind is float:
    return isinstance(data, int | float) and not isinstance(data, bool) and math.isfinite(data)
  return isinstance(data, kind) and (kind is bool or not isinstance(data, bool))


def _is_required(field: "dataclasses.Field[Any]") -> bool:
  return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
