"""JSON schema of `bundle.json`: `python deploy_schema.py` writes the published copy."""

import dataclasses
import json
import types
import typing
from pathlib import Path
from typing import Any, Literal

import mjlab_deploy

PUBLISHED = Path(mjlab_deploy.__file__).with_name("bundle.schema.json")


def bundle_schema() -> dict[str, Any]:
  """Return the JSON schema of `bundle.json`."""
  return {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "mjlab policy bundle",
    **schema(mjlab_deploy.Description),
  }


def schema(kind: Any) -> dict[str, Any]:
  """Return the JSON schema (draft 2020-12) of a type: a dataclass, or what its fields are made of."""
  if kind is Any:
    return {}
  missing = dataclasses.MISSING
  if dataclasses.is_dataclass(kind):
    return {
      "type": "object",
      "properties": {name: schema(hint) for name, hint in typing.get_type_hints(kind).items()},
      "required": [f.name for f in dataclasses.fields(kind) if f.default is missing is f.default_factory],
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


if __name__ == "__main__":
  PUBLISHED.write_text(json.dumps(bundle_schema(), indent=1) + "\n", encoding="utf-8")
