"""Actions: splitting, history, and what is refused."""

from dataclasses import dataclass
from typing import Any

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_managers import ActionManager, ActionTerm, ActionTermCfg


@dataclass(kw_only=True)
class ScaledCfg(ActionTermCfg):
  width: int
  scale: float = 1.0
  drives: tuple[str, ...] = ()

  def build(self, env: Any) -> "Scaled":
    return Scaled(self, env)


class Scaled(ActionTerm):
  cfg: ScaledCfg

  def __init__(self, cfg: ScaledCfg, env: Any) -> None:
    super().__init__(cfg, env)
    self.target = self.state((cfg.width,))
    self.applied = 0

  @property
  def action_dim(self) -> int:
    return self.cfg.width

  @property
  def driven(self) -> set[str]:
    return set(self.cfg.drives)

  def process_actions(self, actions: torch.Tensor) -> None:
    torch.mul(actions, self.cfg.scale, out=self.target)

  def apply_actions(self) -> None:
    self.applied += 1


def build(env: Any) -> ActionManager:
  terms: dict[str, ActionTermCfg | None] = {
    "legs": ScaledCfg(entity="robot", width=2, scale=10.0),
    "arm": ScaledCfg(entity="robot", width=1),
  }
  return ActionManager(terms, env)


def target(manager: ActionManager, name: str) -> torch.Tensor:
  term = manager.get_term(name)
  assert isinstance(term, Scaled)
  return term.target


def test_each_term_gets_its_columns(env):
  manager = build(env)
  action = torch.rand(4, 3)
  manager.process_action(action)
  assert manager.total_action_dim == 3
  assert torch.equal(target(manager, "legs"), action[:, :2] * 10)
  assert torch.equal(manager.get_term("arm").raw_action, action[:, 2:])
  manager.apply_action()
  assert manager.terms(1) == [("legs", action[1, :2].tolist()), ("arm", action[1, 2:].tolist())]


def test_the_last_three_raw_actions_are_kept_and_zeroed_where_an_episode_ends(env):
  manager = build(env)
  actions = [torch.rand(4, 3) for _ in range(4)]
  for action in actions:
    manager.process_action(action)
  kept = (manager.action, manager.prev_action, manager.prev_prev_action)
  for got, expected in zip(kept, reversed(actions[1:]), strict=True):
    assert torch.equal(got, expected)
  manager.reset(env.mask(1))
  for got, expected in zip(kept, reversed(actions[1:]), strict=True):
    assert torch.equal(got[[0, 2, 3]], expected[[0, 2, 3]])
    assert (got[1] == 0).all()
  assert (target(manager, "legs")[1] == 0).all()


def test_entries_that_are_no_numbers_become_zero_and_are_counted(env, logged):
  manager = build(env)
  action = torch.ones(4, 3)
  action[0, 0], action[1, 1] = torch.nan, -torch.inf
  manager.process_action(action)
  assert manager.action.sum() == 10.0
  assert logged(manager) == {"Nonfinite/action": 2.0}
  manager.clear_log()
  assert str(logged(manager)["Nonfinite/action"]) == "nan"


def test_two_terms_that_drive_the_same_thing_are_an_error(env):
  terms: dict[str, ActionTermCfg | None] = {
    "position": ScaledCfg(entity="robot", width=1, drives=("robot/hip", "robot/knee")),
    "effort": ScaledCfg(entity="robot", width=1, drives=("robot/knee",)),
  }
  with pytest.raises(ConfigError, match="terms 'position' and 'effort' both drive robot/knee"):
    ActionManager(terms, env)


def test_a_term_that_cannot_be_built_is_named(env):
  @dataclass(kw_only=True)
  class Broken(ScaledCfg):
    def build(self, env: Any) -> Scaled:
      raise ValueError("no such actuator")

  with pytest.raises(ConfigError, match=r"ActionManager: term 'legs': ValueError while making it .*: no such actuator"):
    ActionManager({"legs": Broken(entity="robot", width=1)}, env)


def test_a_step_asks_the_device_nothing(env, dispatched):
  manager = build(env)
  action, mask = torch.rand(4, 3), env.mask(1)
  # Two multiplications of the terms' own.
  assert len(dispatched(lambda: manager.process_action(action))) <= 2 + 6
  dispatched(lambda: manager.reset(mask))


def test_a_double_precision_policy_is_not_taken_for_broken(make_env, logged):
  manager = build(make_env())
  manager.process_action(torch.rand(4, 3, dtype=torch.float64))
  assert str(logged(manager)["Nonfinite/action"]) == "nan"
