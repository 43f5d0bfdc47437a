"""Numeric fields of configs that declare what they allow, and one function that checks them."""

from __future__ import annotations

import math
from dataclasses import Field, field, fields
from typing import Any, Literal, NoReturn

import numpy as np


def scaled(
  ends: tuple[float, float], *, harder: Literal["more", "less"], least: float = 0.0, most: float = math.inf
) -> Any:
  """Declare a setting that difficulty changes: its values at difficulty 0 and 1. `harder` is the direction."""
  order = "grow with difficulty" if harder == "more" else "fall with difficulty"
  return _field(ends, least=least, most=most, parts="easiest, hardest", order=order)


def drawn(ends: tuple[float, float], *, least: float = 0.0, most: float = math.inf, inside: bool = False) -> Any:
  """Declare a range of random or allowed values: lowest and highest. `inside` is that of `number`."""
  return _field(ends, least=least, most=most, parts="lowest, highest", order="go from low to high", inside=inside)


def number(
  value: float | tuple[float, ...] | None,
  *,
  least: float = 0.0,
  most: float = math.inf,
  inside: bool = False,
  whole: bool = False,
) -> Any:
  """Declare a number, or a tuple of independent numbers.

  The value must be a whole number with `whole`, or if the default is one. It may be None if the default is None. A
  tuple keeps its length. With `inside`, the value is a length that fits inside the border of a tile.
  """
  return _field(value, least=least, most=most, inside=inside, whole=whole or isinstance(value, int))


def choice(value: str, *others: str) -> Any:
  """Declare a word, `value` by default or one of `others`."""
  return _field(value, words=(value, *others))


def _field(default: Any, **rule: Any) -> Any:
  return field(default=default, metadata={"rule": rule})


def rule_of(declared: Field[Any]) -> dict[str, Any]:
  """Return the rule of a field; empty if it has none."""
  return declared.metadata.get("rule", {})


def check_fields(cfg: Any, name: str) -> None:
  """Check all declared fields of a config; `name` is its name in messages.

  Raises:
    ValueError: a value is out of its range; the message says what would work.
  """
  for f in fields(cfg):
    value, rule = getattr(cfg, f.name), rule_of(f)
    if rule and not (value is None and f.default is None) and (problem := _problem(value, f.default, rule)):
      refuse(cfg, name, f"{f.name} {problem}")


def refuse(cfg: object, name: str, message: str) -> NoReturn:
  """Raise a ValueError about a config, called `name`."""
  raise ValueError(f"{type(cfg).__name__} '{name}': {message}.")


def _problem(value: Any, default: Any, rule: dict[str, Any]) -> str:
  """Return the reason why a value breaks its rule, to follow the value's name; empty if it does not."""
  if words := rule.get("words"):
    return "" if value in words else f"must be {' or '.join(map(repr, words))}, got {value!r}"
  is_tuple = isinstance(default, tuple)
  if is_tuple and not (isinstance(value, tuple | list) and len(value) == len(default)):
    return f"must be ({rule.get('parts', f'{len(default)} numbers')}), got {value!r}"
  values: tuple[Any, ...] = tuple(value) if is_tuple else (value,)
  whole = rule.get("whole", False)
  if whole and not isinstance(values[0], int | np.integer):
    return f"must be a whole number, got {value!r}"
  least, most = rule["least"], rule["most"]
  if any(map(math.isnan, values)):
    return f"must be finite, got {value!r}"
  possible = tuple((int if whole else float)(min(max(v, least), most)) for v in values)
  if possible != values:
    bounds = f"at least {least:g}" if math.isinf(most) else f"between {least:g} and {most:g}"
    return f"{value!r} must be {bounds}; {possible if is_tuple else possible[0]} would work"
  order = rule.get("order")
  ordered = tuple(sorted(values, reverse=order == "fall with difficulty"))
  if order and values != ordered:
    return f"{value!r} is the wrong way round: it must {order}; {ordered} would work"
  return ""
