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


def command_help(usage: str, purpose: str, arguments: Any, *, notes: str = "") -> str:
  """Return the help text of a command.

  Args:
    usage: Name of the command and its words: "train TASK [flags]".
    purpose: Description of the command.
    arguments: Dataclass of the flags; a field without a plain value is a part of a task and is left out.
    notes: Text below the flags.
  """
  docs = field_docs(arguments)
  rows = [
    FlagRow(field.name.replace("_", "-"), _metavar(field.type), shown(field.default), docs.get(field.name, ""))
    for field in own_fields_first(arguments)
    if field.type is not Any
  ]
  return flags_help(usage, purpose, rows, notes=notes)


def own_fields_first(cls: Any) -> list[dataclasses.Field[Any]]:
  """Return the fields of a dataclass, and after them those of each of its bases."""
  names = {field.name: field for field in dataclasses.fields(cls)}
  return [names[name] for base in cls.__mro__ for name in vars(base).get("__annotations__", {}) if name in names]


def flags_help(usage: str, purpose: str, rows: Sequence[FlagRow], *, notes: str = "") -> str:
  """Return the help text for flags: a line with name, choices and default each, and the meaning beside or below it."""
  lines = [f"usage: {usage}", "", *textwrap.wrap(purpose, _WIDTH), *([""] if purpose else []), "flags:"]
  for row in rows:
    lead = " ".join(part for part in (f"  --{row.name}", row.choices, f"[{row.default}]") if part)
    if len(lead) > _INDENT - 2:
      lines.append(lead)
      lead = ""
    lines += _wrapped(row.about, f"{lead:<{_INDENT}}") or ([lead] if lead else [])
  lines += _wrapped("Show this text.", f"{'  --help':<{_INDENT}}")
  return "\n".join([*lines, *([f"\n{notes}"] if notes else [])]) + "\n"


def _wrapped(text: str, lead: str) -> list[str]:
  return textwrap.wrap(text, _WIDTH, initial_indent=lead, subsequent_indent=" " * len(lead))


def _metavar(kind: Any) -> str:
  """Return a word for the values of a type; none for a switch."""
  if typing.get_origin(kind) is Annotated:
    return _metavar(typing.get_args(kind)[0])
  arguments = [part for part in typing.get_args(kind) if part not in (type(None), Ellipsis)]
  if typing.get_origin(kind) is Literal:
    return "{" + ",".join(map(str, arguments)) + "}"
  if typing.get_origin(kind) is tuple:
    return f"{_metavar(arguments[0])} ..."
  if arguments:
    return "|".join(map(_metavar, arguments))
  return "" if kind is bool else {str: "TEXT", int: "INT"}.get(kind, "NUMBER")


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
    if not dataclasses.is_dataclass(base):
      continue
    try:
      tree = ast.parse(textwrap.dedent(inspect.getsource(base)))
    except (OSError, TypeError, SyntaxError):
      continue
    body = typing.cast(ast.ClassDef, tree.body[0]).body
    for field, text in itertools.pairwise(body):
      if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
        continue
      if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant) and isinstance(text.value.value, str):
        docs[field.target.id] = " ".join(text.value.value.partition("\n\n")[0].split())
  return docs
