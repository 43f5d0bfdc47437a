"""Structs of arrays of MuJoCo Warp, which kernels take in place of long lists of arguments.

Fields have the names and types that they have in MuJoCo Warp's `Model`, `Option` and `Data`. Arrays of contacts begin
with `contact_`, those of constraint rows with `efc_`.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import mujoco_warp as mjw
import warp as wp

_PARTS = {"contact": mjw.Contact, "efc": mjw.Constraint}
_TYPES: dict[str, Any] = {
  field.name: field.type for owner in (mjw.Option, mjw.Data, mjw.Model) for field in dataclasses.fields(owner)
}
_TYPES |= {f"{part}_{field.name}": field.type for part, owner in _PARTS.items() for field in dataclasses.fields(owner)}


def with_arrays(names: str) -> Callable[[type], Any]:
  """Return a decorator that makes a Warp struct of a class, with fields of MuJoCo Warp before those of the class.

  Args:
    names: Names of the fields, separated by white space.
  """

  def decorate(cls: type) -> Any:
    # A name that another minor of MuJoCo Warp lacks is an error where the struct is used, not where it is imported.
    cls.__annotations__ = {name: _TYPES[name] for name in names.split() if name in _TYPES} | cls.__annotations__
    return wp.struct(cls)

  return decorate


def filled(struct: Any, m: mjw.Model, d: mjw.Data, *others: Any, **own: Any) -> Any:
  """Return a struct with the fields of a model, of data and of others, and with `own` for fields that they lack."""
  values = struct()
  for name in struct.vars:
    part, _, rest = name.partition("_")
    if name in own:
      value = own[name]
    elif part in _PARTS:
      value = getattr(getattr(d, part), rest)
    else:
      value = next(getattr(owner, name) for owner in (m, d, m.opt, *others) if hasattr(owner, name))
    setattr(values, name, value)
  return values


def allocated(struct: Any, **shapes: int | tuple[int, int]) -> Any:
  """Return a struct with arrays of zeros of these shapes; other fields are left as they are."""
  values = struct()
  for name, shape in shapes.items():
    setattr(values, name, wp.zeros(shape, dtype=struct.vars[name].type.dtype))
  return values
