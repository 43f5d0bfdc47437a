"""Help of commands, from dataclasses or from a list of flags; it imports neither tyro nor torch."""

import ast
import dataclasses
import enum
import functools
import inspect
import itertools
import textwrap
import typing
from collections.abc import Sequence
from typing import Annotated, Any, Literal, NamedTuple

_WIDTH = 120
_INDENT = 44


class FlagRow(NamedTuple):
  """One flag in a help text."""

  name: str
  """Name without the two hyphens."""
  choices: str
  """Type or possible values; empty for a switch."""
  default: str
  """Present value."""
  about: str
  """Meaning."""


def field_rows(arguments: Any) -> list[FlagRow]:
  """Return the flags of a dataclass; a field without a plain value is a part of a task and is left out."""
  docs = field_docs(arguments)
  return [
    FlagRow(field.name.replace("_", "-"), _metavar(field.type), shown(field.default), docs.get(field.name, ""))
    for field in own_fields_first(arguments)
    if field.type is not Any
  ]


def own_fields_first(cls: Any) -> list[dataclasses.Field[Any]]:
  """Return the fields of a dataclass, and after them those of each of its bases."""
  names = {field.name: field for field in dataclasses.fields(cls)}
  return [names[name] for base in cls.__mro__ for name in vars(base).get("__annotations__", {}) if name in names]


def help_text(usage: str, purpose: str, rows: Sequence[FlagRow], *, notes: str = "") -> str:
  """Return a help text: a line with name, choices and default of each flag, and the meaning beside or below it.

  Args:
    usage: Name of the command and its words: "train TASK [flags]".
    purpose: Description of the command; may be empty.
    rows: The flags.
    notes: Text below the flags.
  """
  purpose = " ".join(purpose.split())
  lines = [f"usage: {usage}", "", *textwrap.wrap(purpose, _WIDTH), *([""] if purpose else []), "flags:"]
  for row in [*rows, FlagRow("help", "", "", "Show this text.")]:
    lead = " ".join(part for part in (f"  --{row.name}", row.choices, row.default and f"[{row.default}]") if part)
    if len(lead) > _INDENT - 2:
      lines.append(lead)
      lead = ""
    about = textwrap.wrap(row.about, _WIDTH, initial_indent=f"{lead:<{_INDENT}}", subsequent_indent=" " * _INDENT)
    lines += about or ([lead] if lead else [])
  return "\n".join([*lines, *([f"\n{notes}"] if notes else [])]) + "\n"


def _metavar(kind: Any) -> str:
  """Return a word for the values of a type; none for a switch."""
  origin = typing.get_origin(kind)
  arguments = [part for part in typing.get_args(kind) if part not in (type(None), Ellipsis)]
  if origin is Literal:
    return "{" + ",".join(map(str, arguments)) + "}"
  if origin in (tuple, Annotated):
    return _metavar(arguments[0]) + (" ..." if origin is tuple else "")
  if arguments:
    return "|".join(map(_metavar, arguments))
  return {bool: "", str: "TEXT", int: "INT"}.get(kind, "NUMBER")


def shown(value: Any) -> str:
  """Return the present value of a flag as a help text shows it."""
  if isinstance(value, bool):
    return "on" if value else "off"
  if isinstance(value, (tuple, list)):
    return " ".join(map(shown, value)) or "empty"
  return value.name if isinstance(value, enum.Enum) else str(value) or "empty"


@functools.cache
def field_docs(cls: type) -> dict[str, str]:
  """Return the first paragraph of the string under each field of a dataclass and its bases."""
  docs: dict[str, str] = {}
  for base in reversed(cls.__mro__):
    try:
      tree = ast.parse(textwrap.dedent(inspect.getsource(base)))
    except (OSError, TypeError, SyntaxError):
      continue
    for pair in itertools.pairwise(typing.cast(ast.ClassDef, tree.body[0]).body):
      match pair:
        case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
          docs[name] = " ".join(text.partition("\n\n")[0].split())
  return docs
