"""Configs of actions and commands that build any term."""

from dataclasses import dataclass
from typing import Any

from mjlab_managers import ActionTerm, ActionTermCfg, CommandTerm, CommandTermCfg


@dataclass(kw_only=True)
class ActCfg(ActionTermCfg):
  """Action of a class, with an option of its own."""

  entity: str = "robot"
  term: type[ActionTerm]
  option: Any = None

  def build(self, env: Any) -> ActionTerm:
    return self.term(self, env)


@dataclass(kw_only=True)
class GoalCfg(CommandTermCfg):
  """Command of a class, with an option of its own."""

  term: type[CommandTerm]
  option: Any = None

  def build(self, env: Any) -> CommandTerm:
    return self.term(self, env)
