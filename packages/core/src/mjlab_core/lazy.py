"""Imports at first use: of a package's public names, and of libraries that an extra installs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from importlib import import_module
from typing import Any


def lazy_exports(package: str, modules: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
  """Return `__getattr__` and `__dir__` (PEP 562) of a package that imports its public names on demand.

  Args:
    package: `__name__` of the package, which lists its public names in `__all__`.
    modules: Names, separated by spaces, by the module that they are from; ".x" is a module of the package itself.
  """
  homes = {name: module for module, names in modules.items() for name in names.split()}

  def getattr_(name: str) -> Any:
    if name not in homes:
      raise AttributeError(f"module {package!r} has no attribute {name!r}")
    value = getattr(import_module(homes[name], package), name)
    setattr(sys.modules[package], name, value)
    return value

  def dir_() -> list[str]:
    return sorted({*vars(sys.modules[package]), *sys.modules[package].__all__})

  return getattr_, dir_


@contextmanager
def from_extra(extra: str, package: str, user: str) -> Generator[None]:
  """Say which extra of a package to install if an import inside fails.

  Args:
    extra: Name of the extra.
    package: Distribution that has it.
    user: Feature that needs the import.

  Raises:
    ModuleNotFoundError: The library is not installed.
  """
  try:
    yield
  except ModuleNotFoundError as error:
    message = f"{user} needs {error.name}: install {package} with its extra {extra!r}"
    raise ModuleNotFoundError(message, name=error.name) from error
