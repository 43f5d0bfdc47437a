"""Which errors are the user's to mend."""

import contextlib
import re
from collections.abc import Generator

_NO_MEMORY = re.compile(r"out of memory|can't allocate memory|failed to allocate", re.IGNORECASE)


class UsageError(Exception):
  """A command line that makes no sense; the message is the whole answer."""


class BuildError(Exception):
  """Any ValueError or OSError raised while an environment is built: it speaks of the configuration."""


@contextlib.contextmanager
def building() -> Generator[None]:
  """What cannot be built in here is a BuildError."""
  try:
    yield
  except (ValueError, OSError) as error:
    raise BuildError(str(error)) from error


def is_users_mistake(error: BaseException) -> bool:
  """Whether the message alone tells what to change: errors of our own classes, of files, and of too little memory."""
  is_ours = type(error).__module__.partition(".")[0].startswith("mjlab")
  return is_ours or isinstance(error, OSError) or is_out_of_memory(error)


def is_out_of_memory(error: BaseException) -> bool:
  """Whether the machine or a GPU had too little memory; torch and Warp have no class that says so everywhere."""
  return isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and bool(_NO_MEMORY.search(str(error))))
