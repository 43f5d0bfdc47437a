"""The one error of a wrong configuration."""

from __future__ import annotations

from collections.abc import Sequence


class ConfigError(ValueError):
  """A manager's configuration is wrong; lists everything that is, not only the first."""

  def __init__(self, owner: str, problems: Sequence[str]) -> None:
    self.owner, self.problems = owner, tuple(problems)
    lines = [f"{owner}: {problem}" for problem in problems]
    super().__init__(lines[0] if len(lines) == 1 else "\n".join([f"{len(lines)} problems:", *lines]))
