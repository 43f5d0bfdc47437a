"""`list-envs [KEYWORD]`: the tasks and the packages that offer them."""

import sys

from mjlab.cli._errors import UsageError
from mjlab.registry import task_entries

_HELP = """\
usage: list-envs [KEYWORD]

Lists the tasks whose name contains KEYWORD (upper and lower case alike), with the package that offers them.
"""


def run(arguments: list[str]) -> int:
  """List the tasks; returns 0 also where none fits."""
  if "-h" in arguments or "--help" in arguments:
    print(_HELP, end="")
    return 0
  options = [argument for argument in arguments if argument.startswith("-")]
  if options:
    raise UsageError(f"{options[0]}: no such option. usage: list-envs [KEYWORD]")
  if len(arguments) > 1:
    raise UsageError("list-envs takes one KEYWORD at most")
  keyword = arguments[0] if arguments else ""
  entries = [entry for entry in task_entries() if keyword.lower() in entry.name.lower()]
  if not entries:
    print(f"no task contains '{keyword}'" if keyword else "no task is installed", file=sys.stderr)
    return 0
  width = max(len("task"), *(len(entry.name) for entry in entries))
  print(f"{'task':<{width}}  package")
  for entry in entries:
    print(f"{entry.name:<{width}}  {entry.package}")
  return 0
