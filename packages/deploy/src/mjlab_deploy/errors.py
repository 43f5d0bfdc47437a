"""The error of policy bundles and of their runner, and helpers that raise it for other libraries."""

import contextlib
import importlib
from collections.abc import Collection, Generator
from pathlib import Path
from typing import Any


class DeployError(ValueError):
  """Error about a user's input: a bundle that cannot be read, a robot that does not fit it, or an option."""


@contextlib.contextmanager
def reading(what: object, *errors: type[Exception]) -> Generator[None]:
  """Turn errors inside into one line that begins with the name of what is read or written.

  Args:
    what: Name for the message.
    *errors: Errors that a damaged file causes, besides `DeployError` and `OSError`.

  Raises:
    DeployError: The code inside failed with one of these errors.
  """
  try:
    yield
  except DeployError as error:
    raise DeployError(f"{what}: {error}") from error
  except OSError as error:
    raise DeployError(f"{what}: {error.strerror or error}") from error
  except errors as error:
    raise DeployError(f"{what}: {' '.join(str(error).split())[:200]}") from error


def check_known(kind: str, name: str, known: Collection[str]) -> str:
  """Return a name that exists.

  Raises:
    DeployError: It is not among those that exist; the message lists them.
  """
  if name not in known:
    raise DeployError(f"{kind} {name[:60]!r} does not exist; there are {', '.join(map(repr, known))[:400] or 'none'}")
  return name


def read_limited(path: Path, max_bytes: int) -> bytes:
  """Return the contents of a file.

  Raises:
    DeployError: It is larger than it may be.
  """
  with path.open("rb") as file:
    data = file.read(max_bytes + 1)
  if len(data) > max_bytes:
    raise DeployError(f"larger than the {max_bytes >> 20} MiB that it may have")
  return data


def library(name: str, hint: str) -> Any:
  """Return a module of an optional library.

  Raises:
    DeployError: It is not installed; the message ends with `hint`.
  """
  try:
    return importlib.import_module(name)
  except ImportError as error:
    raise DeployError(f"{name.partition('.')[0]} is not installed ({error}): {hint}") from error
