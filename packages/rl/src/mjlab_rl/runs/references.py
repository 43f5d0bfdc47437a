"""Names of functions, classes and enums in files, and the packages that a name may point into.

Resolving a name imports a module of a trusted package and looks the name up. It calls nothing.
"""

import functools
import importlib
import importlib.util
import re
import sys
from importlib import metadata
from pathlib import Path
from types import FunctionType, MethodType, ModuleType
from typing import Any

from mjlab_core import nearest, printable
from mjlab_core.errors import ConfigError, FileError
from mjlab_core.names import check_name

TASK_GROUP = "mjlab.tasks"
"""Entry-point group of tasks. A distribution that offers one is trusted."""
ROBOT_GROUP = "mjlab.robots"
"""Entry-point group of robots, trusted likewise: runs name the functions of a robot's package."""
_REFERENCE = re.compile(r"(?P<module>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*):(?P<name>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)", re.A)
_CACHED = type(functools.cache(str))
_trusted_here: set[str] = set()


def trust_package(name: str) -> None:
  """Let files name functions and classes of an import package, in this process.

  Members of mjlab, and distributions with an entry point of group `mjlab.tasks` or `mjlab.robots`, need no call.

  Args:
    name: Top-level import name, such as "my_robots".
  """
  _trusted_here.add(name)


def reference(value: Any, where: str) -> str:
  """Return the name "module:qualname" of a function or class.

  Raises:
    ConfigError: `resolve` would not give `value` back for that name; the message names the field `where`.
  """
  module: str = getattr(value, "__module__", None) or ""
  name: str = getattr(value, "__qualname__", None) or ""
  if not name or "<" in name:
    kind = "a lambda" if "<lambda>" in name else repr(name or value)
    raise ConfigError(f"{where}: {kind} has no importable name: write `def` at the top of a module, with params.")
  if module == "__main__":
    raise ConfigError(f"{where}: '{name}' is defined in a script; move it into a module that can be imported.")
  try:
    found = resolve(f"{module}:{name}", where)
  except FileError as error:
    raise ConfigError(f"{error}, so the run could not be loaded again") from error
  if found != value:
    raise ConfigError(f"{where}: '{module}:{name}' is another object than the one of that name.")
  return f"{module}:{name}"


def resolve(text: object, where: str, extra: frozenset[str] = frozenset()) -> Any:
  """Return the function or class that a file names.

  Args:
    text: "module:qualname" from the file.
    where: Field that the name is in, for messages.
    extra: Import packages that are trusted in this field besides the usual ones.

  Raises:
    FileError: The name is malformed, its package is not trusted, or no function or class of that name is defined there.
  """
  try:
    return _resolved(text, extra)
  except FileError as error:
    raise FileError(f"{where}: reference {printable(text, 120)!r} {error}") from error


def _resolved(text: object, extra: frozenset[str]) -> Any:
  match = _REFERENCE.fullmatch(text) if isinstance(text, str) else None
  if match is None or re.search(r"(^|[.:])__", match.string):
    raise FileError("is not of the form 'module:name', without names that begin with two underscores")
  module_name, name = match["module"], match["name"]
  package = module_name.partition(".")[0]
  if package not in _trusted_here | _installed_packages() | extra:
    raise FileError(
      f"is refused: package '{package}' is not trusted. Members of mjlab and packages with an entry point of group "
      f"'{TASK_GROUP}' or '{ROBOT_GROUP}' are; for another package call mjlab_rl.trust_package('{package}') first"
    )
  try:
    found = _definition(_import(module_name, package), name)
  except FileError:
    if (moved := _exported(module_name, name, package)) is None:
      raise
    return moved
  if not _is_definition(found) and not (isinstance(found, MethodType) and isinstance(found.__self__, type)):
    raise FileError(f"is refused: it is a {type(found).__name__}, not a function or class")
  if (found.__module__, found.__qualname__) != (module_name, name):
    raise FileError(f"is refused: it is defined elsewhere, as '{found.__module__}:{found.__qualname__}'")
  return found


def _is_definition(value: Any) -> bool:
  return isinstance(value, (FunctionType, type, _CACHED))


def resolve_enum(text: object, member: str, where: str) -> Any:
  """Return a member of an enum of a trusted package or of MuJoCo.

  Raises:
    MjlabError: There is no such enum or member.
  """
  is_of_mujoco = isinstance(text, str) and re.fullmatch(r"mujoco\._enums:mjt\w+", text)
  kind = resolve(text, where, frozenset({"mujoco"} if is_of_mujoco else ()))
  members = getattr(kind, "__members__", None)
  if members is None or not isinstance(kind, type):
    raise FileError(f"{where}: {printable(text, 120)!r} is not an enum")
  return members[check_name("member", printable(member, 120), members, f"{where}: enum {printable(text, 120)!r}")]


def offered() -> list[metadata.EntryPoint]:
  """Return the entry points of all tasks and robots."""
  return [point for group in (TASK_GROUP, ROBOT_GROUP) for point in metadata.entry_points(group=group)]


def distribution_name(distribution: metadata.Distribution) -> str:
  """Return the name of an installed distribution; empty if it has none. `Distribution.name` reads ten times longer."""
  text = distribution.read_text("METADATA") or distribution.read_text("PKG-INFO") or ""
  found = re.search(r"^Name:[ \t]*(\S+)", text, re.MULTILINE)
  return found[1] if found else distribution.name or ""


@functools.cache
def _installed_packages() -> frozenset[str]:
  """Return the import packages of all members and of all distributions that offer tasks or robots."""
  points = offered()
  packages = {point.module.partition(".")[0] for point in points}
  offering = {distribution_name(point.dist) for point in points if point.dist is not None}
  for distribution in metadata.distributions():
    name = distribution_name(distribution)
    if name == "mjlab" or name.startswith("mjlab-"):
      packages.add(name.replace("-", "_"))
    elif name in offering:
      files = [file.parts[0].removesuffix(".py") for file in distribution.files or () if file.suffix == ".py"]
      packages.update(files, (distribution.read_text("top_level.txt") or "").split())
  return frozenset(name for name in packages if name.isidentifier())


def _import(module_name: str, package: str) -> ModuleType:
  """Import a module that lies in the folder of its top-level package."""
  if (module := sys.modules.get(module_name)) is not None:
    return module
  try:
    top = importlib.import_module(package)
    if module_name == package:
      return top
    spec = importlib.util.find_spec(module_name)
    origin = Path(spec.origin).resolve() if spec is not None and spec.origin is not None else None
    if origin is not None and any(origin.is_relative_to(Path(folder).resolve()) for folder in top.__path__):
      return importlib.import_module(module_name)
  except Exception as error:
    raise FileError(f"cannot be resolved: '{module_name}' cannot be imported ({printable(error, 200)})") from error
  raise FileError(f"is refused: there is no module '{module_name}' in the folder of package '{package}'")


def _exported(module_name: str, name: str, package: str) -> Any:
  """Return the function or class of this name that a package above a module exports; None if there is none.

  Definitions move between the modules of a package, whose public names stay.
  """
  parent = module_name
  while parent := parent.rpartition(".")[0]:
    try:
      module = _import(parent, package)
    except FileError:
      continue
    found: Any = getattr(module, name) if name in getattr(module, "__all__", ()) else None
    if _is_definition(found) and found.__qualname__ == name and found.__module__.partition(".")[0] == package:
      return found
  return None


def _definition(module: ModuleType, name: str) -> Any:
  """Look a name up in the module's own dictionary and in those of its classes."""
  found: Any = module
  for part in name.split("."):
    if found is not module and not isinstance(found, type):
      raise FileError(f"is refused: it leads through a {type(found).__name__}")
    names = vars(found)
    if part not in names:
      close = nearest(part, names, 1)
      hint = f". Nearest: {close[0]}" if close else ""
      raise FileError(f"does not exist: '{found.__name__}' has no '{part}'{hint}")
    found = getattr(found, part) if isinstance(names[part], (classmethod, staticmethod)) else names[part]
  return found
