"""Numeric fields of configs that declare what they allow, and one function that checks them."""

from __future__ import annotations

import math
from dataclasses import field, fields
from typing import Any, Literal, NoReturn

import numpy as np


def scaled(
  ends: tuple[float, float], *, harder: Literal["more", "less"], least: float = 0.0, most: float = math.inf
) -> Any:
  """Declare a setting that difficulty changes: its value at difficulty 0 and at 1. `harder` is its direction."""
  return field(default=ends, metadata={"kind": "scaled", "harder": harder, "least": least, "most": most})


def drawn(ends: tuple[float, float], *, least: float = 0.0, most: float = math.inf, inside: bool = False) -> Any:
  """Declare a range, lowest and highest value, that a value is drawn from or may be in; for `inside`, see `number`."""
  return field(default=ends, metadata={"kind": "drawn", "least": least, "most": most, "inside": inside})


def number(
  value: float | tuple[float, ...] | None, *, least: float = 0.0, most: float = math.inf, inside: bool = False
) -> Any:
  """Declare a number, or a tuple of independent numbers.

  If the default is a whole number, so is the value; if it is None, the value may be None; a tuple keeps its length.
  With `inside`, it is a length that fits inside the border of a tile.
  """
  return field(default=value, metadata={"kind": "number", "least": least, "most": most, "inside": inside})


def count(value: int | None, *, least: int = 0) -> Any:
  """Declare an optional whole number."""
  return field(default=value, metadata={"kind": "count", "least": least, "most": math.inf})


def choice(value: str, *others: str) -> Any:
  """Declare a word, `value` by default or one of `others`."""
  return field(default=value, metadata={"kind": "choice", "words": (value, *others)})


def check_fields(cfg: Any, name: str) -> None:
  """Check all declared fields of a config; `name` is its name in messages.

  Raises:
    ValueError: a value is out of its range; the message says what would work.
  """
  for f in fields(cfg):
    if "kind" in f.metadata:
      _check(cfg, name, f.name, f.metadata, f.default)


def refuse(cfg: object, name: str, message: str) -> NoReturn:
  """Raise a ValueError about a config, called `name`."""
  raise ValueError(f"{type(cfg).__name__} '{name}': {message}.")


def _check(cfg: Any, name: str, setting: str, rule: Any, default: Any) -> None:
  value: Any = getattr(cfg, setting)
  if value is None and default is None:
    return
  if rule["kind"] == "choice":
    if value not in rule["words"]:
      refuse(cfg, name, f"{setting} must be {' or '.join(map(repr, rule['words']))}, got {value!r}")
    return
  is_range = rule["kind"] in ("scaled", "drawn")
  if is_range or isinstance(default, tuple):
    if not (isinstance(value, tuple | list) and len(value) == len(default)):
      names = {"scaled": "easiest, hardest", "drawn": "lowest, highest"}.get(rule["kind"], f"{len(default)} numbers")
      refuse(cfg, name, f"{setting} must be ({names}), got {value!r}")
    values: tuple[Any, ...] = tuple(value)
  else:
    is_whole = rule["kind"] == "count" or isinstance(default, int)
    if is_whole and not isinstance(value, int | np.integer):
      refuse(cfg, name, f"{setting} must be a whole number, got {value!r}")
    values = (value,)
  least, most = rule["least"], rule["most"]
  if any(math.isnan(v) or (math.isinf(v) and v not in (-most, most)) for v in values):
    refuse(cfg, name, f"{setting} must be finite, got {value!r}")
  possible = tuple(min(max(v, least), most) for v in values)
  if possible != values:
    kind = int if rule["kind"] == "count" or isinstance(default, int) else float
    instead = tuple(map(float, possible)) if isinstance(default, tuple) else kind(possible[0])
    bounds = f"at least {least:g}" if math.isinf(most) else f"between {least:g} and {most:g}"
    refuse(cfg, name, f"{setting} {value!r} must be {bounds}; {instead} would work")
  if not is_range:
    return
  first, second = values
  down = rule.get("harder") == "less"
  if (first < second) if down else (first > second):
    order = f"{'fall' if down else 'grow'} with difficulty" if rule["kind"] == "scaled" else "go from low to high"
    refuse(cfg, name, f"{setting} {value!r} is the wrong way round: it must {order}; {(second, first)} would work")
