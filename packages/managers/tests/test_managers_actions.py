"""Actions: splitting, history, and what is refused."""

from typing import Any

import pytest
import torch
from managers_terms import ActCfg
from mjlab_core.errors import ConfigError
from mjlab_managers import ActionManager, ActionTerm


class Scaled(ActionTerm):
  """Scales as many columns as its option says: width, scale and names of what it drives."""

  cfg: ActCfg

  def __init__(self, cfg: ActCfg, env: Any) -> None:
    super().__init__(cfg, env)
    self.width, self.scale, *self.drives = cfg.option
    self.target = self.state((self.width,))

  @property
  def action_dim(self) -> int:
    return self.width

  @property
  def driven(self) -> set[str]:
    return set(self.drives)

  def process_actions(self, actions: torch.Tensor) -> None:
    torch.mul(actions, self.scale, out=self.target)


def build(env: Any, **options: Any) -> ActionManager:
  options = options or {"legs": (2, 10.0), "arm": (1, 1.0)}
  return ActionManager({name: ActCfg(term=Scaled, option=option) for name, option in options.items()}, env)


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
  with pytest.raises(ConfigError, match="terms 'position' and 'effort' both drive robot/knee"):
    build(env, position=(1, 1.0, "robot/hip", "robot/knee"), effort=(1, 1.0, "robot/knee"))


def test_a_term_that_cannot_be_built_is_named(env):
  with pytest.raises(ConfigError, match=r"ActionManager: term 'legs': ValueError while making it .*: not enough"):
    build(env, legs=())


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
