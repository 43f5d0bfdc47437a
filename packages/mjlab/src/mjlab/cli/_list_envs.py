"""`list-envs [KEYWORD]`: the tasks and the packages that offer them."""

import sys

from mjlab_core.io.tables import table

from mjlab.cli.shared._command_line import CommandLine, CommonArguments
from mjlab.registry import task_entries


@CommandLine("list-envs", "[KEYWORD]", CommonArguments)
def run(_: CommonArguments, keywords: list[str]) -> int:
  """List the tasks whose names contain KEYWORD, in upper or lower case, with the packages that offer them."""
  keyword = "".join(keywords)
  entries = [entry for entry in task_entries() if keyword.lower() in entry.name.lower()]
  if not entries:
    print(f"no task contains '{keyword}'" if keyword else "no task is installed", file=sys.stderr)
    return 0
  print(table(("task", "package"), [(entry.name, entry.package) for entry in entries]))
  return 0
