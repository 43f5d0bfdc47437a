"""Packages from templates: files that are written whole into a folder that does not exist."""

import json
import keyword
import re
import sys
from collections.abc import Mapping
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from string import Template

from mjlab_core import AtomicWrite, UsageError, safe_name

_WIDTH = 118


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


def write_package(folder: Path, files: Mapping[str, str | bytes]) -> None:
  """Write a package whole, or nothing."""
  folder.parent.mkdir(parents=True, exist_ok=True)
  with AtomicWrite(folder) as made:
    for name, content in files.items():
      path = made / name
      path.parent.mkdir(parents=True, exist_ok=True)
      path.write_bytes(content if isinstance(content, bytes) else content.encode())


def source(value: object, indent: int = 0, lead: int = 0) -> str:
  """Return Python source of strings, numbers, tuples and dicts.

  Args:
    value: What to write.
    indent: Column at which the statement begins.
    lead: Columns before the value on its line.
  """
  if isinstance(value, str):
    return json.dumps(value, ensure_ascii=False)
  if isinstance(value, tuple | dict):
    items = list(value.items()) if isinstance(value, dict) else list(value)
    brackets = "{}" if isinstance(value, dict) else "()"
    flat = ", ".join(_item(item, value, 0) for item in items)
    comma = "," if isinstance(value, tuple) and len(items) == 1 else ""
    if indent + lead + len(flat) + 2 <= _WIDTH:
      return f"{brackets[0]}{flat}{comma}{brackets[1]}"
    pad = " " * (indent + 2)
    lines = "".join(f"{pad}{_item(item, value, indent + 2)},\n" for item in items)
    return f"{brackets[0]}\n{lines}{' ' * indent}{brackets[1]}"
  if isinstance(value, float):
    return repr(float(f"{value:.6g}"))
  return repr(value)


def _item(item: object, of: object, indent: int) -> str:
  if isinstance(of, dict):
    key, value = item  # type: ignore
    return f"{source(key)}: {source(value, indent)}"
  return source(item, indent)
