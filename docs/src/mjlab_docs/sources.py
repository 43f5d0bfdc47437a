"""Extension of Sphinx: source of the public API as griffe has read it, so that viewcode imports and parses nothing."""

from collections.abc import Iterator, Mapping

import griffe
from sphinx.application import Sphinx
from sphinx.domains.python import ObjectEntry, PythonDomain
from sphinx.environment import BuildEnvironment

_DEFINED: dict[str, griffe.Module] = {}
"""Module that defines each documented name, by the path of the name."""
_MODULES: dict[str, griffe.Module] = {}


def remember(defined: Mapping[str, griffe.Module]) -> None:
  """Take the modules that define documented names.

  Args:
    defined: Modules, by the path under which a name is documented.
  """
  _DEFINED.update(defined)
  _MODULES.update({module.path: module for module in defined.values()})


def setup(app: Sphinx) -> dict[str, bool]:
  """Answer viewcode's questions, and look names up quickly."""
  app.connect("viewcode-follow-imported", defining_module)
  app.connect("viewcode-find-source", code_and_tags)
  app.add_domain(_PythonDomain, override=True)
  return {"parallel_read_safe": True, "parallel_write_safe": True}


class _PythonDomain(PythonDomain):
  """Python domain that compares a name with all objects only if one of them ends with it."""

  _ends: set[str] | None = None

  def find_obj(
    self, env: BuildEnvironment, modname: str, classname: str, name: str, type: str | None, searchmode: int = 0
  ) -> list[tuple[str, ObjectEntry]]:
    if self._ends is None:
      self._ends = {known.rpartition(".")[2] for known in self.objects}
    if name.removesuffix("()").rpartition(".")[2] not in self._ends:
      return []
    return super().find_obj(env, modname, classname, name, type, searchmode)


def defining_module(app: Sphinx | None, documented: str, name: str) -> str:
  """Return the module that defines a name; `documented` is the one that exports it."""
  del app
  module = _DEFINED.get(f"{documented}.{name.partition('.')[0]}")
  return documented if module is None else module.path


def code_and_tags(app: Sphinx | None, name: str) -> tuple[str, dict[str, tuple[str, int, int]]]:
  """Return the code of a module, and kind, first and last line of its classes and functions."""
  del app
  module = _MODULES.get(name)
  return ("", {}) if module is None else (module.source, dict(_tags(module)))


def _tags(parent: griffe.Module | griffe.Class, prefix: str = "") -> Iterator[tuple[str, tuple[str, int, int]]]:
  """Yield kind, first and last line of the classes and functions of a module or class."""
  for name, member in parent.members.items():
    if isinstance(member, griffe.Class | griffe.Function) and member.lineno and member.endlineno:
      kind = "class" if isinstance(member, griffe.Class) else "def"
      yield f"{prefix}{name}", (kind, member.lineno, member.endlineno)
      if isinstance(member, griffe.Class):
        yield from _tags(member, f"{prefix}{name}.")
