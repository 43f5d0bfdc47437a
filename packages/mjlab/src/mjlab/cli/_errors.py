"""Which errors are the user's to mend."""


class UsageError(Exception):
  """A command line that makes no sense; the message is the whole answer."""


class BuildError(Exception):
  """Any ValueError or OSError raised while an environment is built: it speaks of the configuration."""


def is_users_mistake(error: BaseException) -> bool:
  """Whether the message alone tells what to change: errors of our own classes, and files that are not there."""
  return type(error).__module__.partition(".")[0].startswith("mjlab") or isinstance(error, FileNotFoundError)
