"""Configs of actions and commands that build any term."""

from dataclasses import dataclass
from typing import Any

from mjlab_managers import ActionTerm, ActionTermCfg, CommandTerm, CommandTermCfg


@dataclass(kw_only=True)
class ActCfg(ActionTermCfg):
  """Action of any class, with an option."""

  entity: str = "robot"
  term: type[ActionTerm]
  option: Any = None

  def build(self, env: Any) -> ActionTerm:
    return self.term(self, env)


@dataclass(kw_only=True)
class GoalCfg(CommandTermCfg):
  """Command of any class, with an option."""

  term: type[CommandTerm]
  option: Any = None

  def build(self, env: Any) -> CommandTerm:
    return self.term(self, env)
