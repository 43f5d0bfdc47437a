"""Errors that mjlab raises: one base class, and a subclass for each failure that callers handle separately."""

from __future__ import annotations


class MjlabError(ValueError):
  """Base of all errors in the input of a user: a config, a name, a file, a value."""


class UnknownNameError(MjlabError, KeyError):
  """Lookup by name or pattern that fails; the message lists the existing names, the nearest first."""

  def __str__(self) -> str:
    # KeyError would show its message quoted and escaped.
    return str(self.args[0]) if self.args else ""


class ConfigError(MjlabError):
  """Configuration that cannot work. It carries every problem found, not only the first.

  Args:
    problems: one line for each problem, each with the name of its part.
  """

  def __init__(self, *problems: str) -> None:
    super().__init__(*problems)

  @property
  def problems(self) -> tuple[str, ...]:
    """One line for each problem."""
    return self.args

  def __str__(self) -> str:
    return "\n".join(self.args if len(self.args) < 2 else (f"{len(self.args)} problems:", *self.args))


_CONSEQUENCE = "It follows from a mistake that is reported itself."


def as_consequence(error: Exception) -> Exception:
  """Mark an error as following from a mistake in a config, so that only the mistake is reported; return it."""
  error.add_note(_CONSEQUENCE)
  return error


def is_consequence(error: BaseException | None) -> bool:
  """Return True if an error, or one that it comes from, is marked by `as_consequence`."""
  while error is not None:
    if _CONSEQUENCE in getattr(error, "__notes__", ()):
      return True
    error = error.__cause__ or error.__context__
  return False


class FileError(MjlabError):
  """File that cannot be read; the message gives its path and the reason."""


class DivergedError(MjlabError):
  """NaN or infinite numbers where the computation cannot continue with them."""


class RenderingError(MjlabError):
  """Missing or broken OpenGL."""


class UsageError(MjlabError):
  """Command line that cannot be run; the process exits with status 2."""
