"""Page of all commands, from their help."""

import contextlib
import io
from collections.abc import Iterator

from mjlab import cli

from mjlab_docs.pages import Site


def write(site: Site) -> None:
  """Write `reference/commands.md`."""
  site.write("reference/commands.md", "\n".join(_page()) + "\n")


def _page() -> Iterator[str]:
  overview = _output("--help")
  yield "# Commands\n"
  yield "Each command exists as `mjlab COMMAND` and under its own name. From a clone, put `uv run` before it.\n"
  yield f"```text\n{overview}```\n"
  names = [line.split()[0] for line in overview.splitlines() if line.startswith("  ")]
  for name in names:
    yield f"## {name}\n\n```text\n{_output(name, '--help')}```\n"


def _output(*words: str) -> str:
  with contextlib.redirect_stdout(io.StringIO()) as shown:
    cli.main(words)
  return shown.getvalue().rstrip() + "\n"
