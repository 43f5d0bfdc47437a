"""Settings of types, for the controls of a page and as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args, get_type_hints

from mjlab_terrain.tile_cfg import TileCfg

Kind = Literal["pair", "number", "whole", "flag", "choice"]


@dataclass(frozen=True, kw_only=True)
class Setting:
  """Setting of a type that can be changed."""

  name: str
  kind: Kind
  """Two numbers, a number, a whole number, yes or no, or one of some words."""
  least: float = 0.0
  """Least number allowed."""
  choices: tuple[str, ...] = ()
  """Words to choose from."""


def settings_of(cfg: TileCfg) -> list[Setting]:
  """Return the settings of a type that can be shown: all but its share, and those that may be None or a file."""
  hints = get_type_hints(type(cfg))
  out = []
  for f in fields(cfg):
    rule, value = f.metadata, getattr(cfg, f.name)
    if f.name == "share" or value is None:
      continue
    if rule.get("kind") in ("scaled", "drawn"):
      out.append(Setting(name=f.name, kind="pair", least=rule["least"]))
    elif rule.get("kind") in ("number", "count"):
      out.append(Setting(name=f.name, kind="whole" if isinstance(value, int) else "number", least=rule["least"]))
    elif isinstance(value, bool):
      out.append(Setting(name=f.name, kind="flag"))
    elif isinstance(value, str) and get_args(hints[f.name]):
      out.append(Setting(name=f.name, kind="choice", choices=get_args(hints[f.name])))
  return out


def apply_settings(types: dict[str, TileCfg], assignments: Sequence[str]) -> None:
  """Change settings in place: "setting=value" of all types that have it, "type.setting=value" of one.

  Raises:
    ValueError: an assignment names what does not exist, or its value cannot be read.
  """
  for assignment in assignments:
    target, _, text = assignment.partition("=")
    type_name, _, setting = target.rpartition(".")
    meant = list(types.values())
    if type_name:
      meant = [types[_known(f"type '{type_name}' here", type_name, types, assignment)]]
    _known(f"setting '{setting}'", setting, sorted({f.name for cfg in meant for f in fields(cfg)}), assignment)
    for cfg in meant:
      if setting in [f.name for f in fields(cfg)]:
        setattr(cfg, setting, _read(text, getattr(cfg, setting), assignment))


def _known(what: str, name: str, names: Iterable[str], assignment: str) -> str:
  if name not in names:
    raise ValueError(f"'{assignment}': there is no {what}. There are {', '.join(names)}.")
  return name


def _read(text: str, present: Any, assignment: str) -> Any:
  """Return the value that `text` gives, of the same kind as the present one."""
  try:
    if isinstance(present, bool):
      return {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}[text.lower()]
    if isinstance(present, str):
      return text
    values = [int(part) if part.strip().lstrip("-").isdigit() else float(part) for part in text.split(",")]
    if isinstance(present, tuple) != (len(values) == 2):
      raise ValueError
  except (KeyError, ValueError):
    raise ValueError(f"'{assignment}': the value must be like {present!r}, without brackets.") from None
  return tuple(values) if isinstance(present, tuple) else values[0]
