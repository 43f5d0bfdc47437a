"""Packages from templates: files that are written whole into a folder that does not exist."""

import dataclasses
import json
import keyword
import re
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import Any

from mjlab_core import AtomicWrite, UsageError, safe_name

_WIDTH = 100


def package_name(text: str) -> str:
  """Return the name of a Python package made from `text`, which may come from a file."""
  name = re.sub(r"[^a-z0-9_]+", "_", safe_name(text).lower()).strip("_")
  return name if re.match(r"[a-z]", name) else f"robot_{name}".rstrip("_")


def check_new_package(name: str, folder: Path) -> None:
  """Refuse a name that is not new, and a folder that exists.

  Raises:
    UsageError: The name is not one of a package, or is taken; the folder exists.
  """
  if not re.fullmatch(r"[a-z][a-z0-9_]{0,60}", name) or keyword.iskeyword(name):
    raise UsageError(f"{name!r} is not a package name: lower-case letters, digits and '_', a letter first")
  if name in sys.stdlib_module_names or find_spec(name) is not None:
    raise UsageError(f"a package '{name}' is installed already; choose another name")
  if folder.exists():
    raise UsageError(f"{folder} exists; nothing is overwritten: --output names another folder")


def filled(template: str, **values: str) -> str:
  """Return a template of `mjlab/new/templates` with its placeholders filled."""
  text = resources.files("mjlab.new").joinpath("templates", template).read_text(encoding="utf-8")
  return Template(text).substitute(values)


def write_package(
  folder: Path, files: Mapping[str, str | bytes], write_more: Callable[[Path], None] = lambda folder: None
) -> None:
  """Write a package whole, or nothing; `write_more` adds files to a folder that becomes the package."""
  folder.parent.mkdir(parents=True, exist_ok=True)
  with AtomicWrite(folder) as made:
    for name, content in files.items():
      path = made / name
      path.parent.mkdir(parents=True, exist_ok=True)
      path.write_bytes(content if isinstance(content, bytes) else content.encode())
    write_more(made)


def source(value: object) -> str:
  """Return Python source of a string or number, or of a tuple or dict of them."""
  if isinstance(value, tuple):
    comma = "," if len(value) == 1 else ""
    return _bracketed("(", [source(item) for item in value], f"{comma})")
  if isinstance(value, dict):
    return _bracketed("{", [f"{source(key)}: {source(item)}" for key, item in value.items()], "}")
  return repr(float(f"{value:.6g}")) if isinstance(value, float) else json.dumps(value, ensure_ascii=False)


def call_source(cfg: Any) -> str:
  """Return Python source of a dataclass, with the fields that differ from their defaults."""
  fields = [field for field in dataclasses.fields(cfg) if getattr(cfg, field.name) != field.default]
  arguments = [f"{field.name}={source(getattr(cfg, field.name))}" for field in fields]
  return _bracketed(f"{type(cfg).__name__}(", arguments, ")")


def _bracketed(left: str, items: Sequence[str], right: str) -> str:
  """Return items in one line, or in a line for each if they are long."""
  flat = left + ", ".join(items) + right
  if len(flat) <= _WIDTH and "\n" not in flat:
    return flat
  lines = textwrap.indent("".join(f"{item},\n" for item in items), "  ")
  return f"{left}\n{lines}{right.lstrip(',')}"
