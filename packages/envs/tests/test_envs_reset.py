"""Resets of some worlds, automatic and explicit, which leave the others alone."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
import torch
from envs_hopper import Make, actions, end, hopper_cfg
from mjlab_core import call_where
from mjlab_envs import ManagerBasedRlEnv
from mjlab_managers import CurriculumTermCfg, EventTermCfg, RecorderTerm, RecorderTermCfg


def leaves(state: Mapping[str, Any], path: str = "") -> dict[str, torch.Tensor]:
  """The tensors of a nested state by path."""
  found = {}
  for key, value in state.items():
    where = f"{path}.{key}"
    found |= leaves(value, where) if isinstance(value, Mapping) else {where: value}
  return found


def assert_rows_equal(before: Mapping[str, Any], after: Mapping[str, Any], rows: list[int], num_envs: int) -> int:
  old, new = leaves(before), leaves(after)
  assert old.keys() == new.keys()
  compared = 0
  for name, value in old.items():
    if name != ".rng" and value.dim() > 0 and value.shape[0] == num_envs:
      assert torch.equal(value[rows], new[name][rows]), name
      compared += 1
  return compared


def test_an_ended_world_sees_what_an_explicit_reset_would_show_it(make: Make, engine: str) -> None:
  states: list[torch.Tensor] = []

  def remember(env: ManagerBasedRlEnv, mask: torch.Tensor) -> None:
    # Curricula come first in a reset.
    states.append(env.rng.get_state())

  cfg = hopper_cfg(engine=engine)
  cfg.curriculum = {"remember": CurriculumTermCfg(remember)}
  cfg.events["push"] = None
  cfg.observations["actor"].corrupt = False
  a, b = make(cfg), make(cfg)
  for step in range(8):
    for env in (a, b):
      env.step(actions(env, step))
  states.clear()
  end(a, 1, 2)
  obs, _, terminated, _, _ = a.step(actions(a, 8))
  assert terminated.tolist() == [False, True, True, False]
  b.rng.set_state(states[0])
  expected, _ = b.reset(env_ids=[1, 2])
  for group in obs:
    assert torch.equal(obs[group][[1, 2]], expected[group][[1, 2]]), group


def test_parts_of_a_step_that_act_on_no_world_change_nothing(make: Make, engine: str, monkeypatch) -> None:
  calls: list[bool] = []

  def always(mask: torch.Tensor, fn: Callable[[torch.Tensor], object], generator: torch.Generator) -> None:
    calls.append(bool(mask.any()))
    call_where(torch.ones(1, dtype=torch.bool), lambda _: fn(mask), generator)

  pushed: list[torch.Tensor] = []

  def push(env: ManagerBasedRlEnv, env_ids: torch.Tensor) -> None:
    pushed.append(torch.rand(env.num_envs, generator=env.rng))

  cfg = hopper_cfg(num_envs=2, engine=engine)
  cfg.events["ids"] = EventTermCfg(push, mode="interval", interval_range_s=(0.05, 0.1))
  outcomes = []
  for every_call in (False, True):
    if every_call:
      for module in ("mjlab_envs.env", "mjlab_managers.command_manager", "mjlab_managers.event_manager"):
        monkeypatch.setattr(f"{module}.call_where", always)
    env = make(cfg)
    pushed.clear()
    steps = []
    for step in range(60):
      observations, *rest, _ = env.step(actions(env, step))
      steps.append((*observations.values(), *rest))
    outcomes.append((steps, leaves(env.state_dict()), torch.stack(pushed)))
  assert len(calls) / 10 < sum(calls) < len(calls) / 2
  (steps, state, own), (all_steps, all_state, all_own) = outcomes
  for step, (one, other) in enumerate(zip(steps, all_steps, strict=True)):
    assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True)), step
  assert [name for name, value in state.items() if not torch.equal(value, all_state[name])] == []
  assert torch.equal(own, all_own)


def test_without_auto_reset_an_ended_world_must_be_reset_before_the_next_step(make: Make) -> None:
  env = make(auto_reset=False)
  env.step(actions(env, 0))
  end(env, 1, 3)
  _, _, terminated, _, _ = env.step(actions(env, 1))
  end(env)
  assert terminated.tolist() == [False, True, False, True]
  assert env.episode_length_buf.tolist() == [2, 2, 2, 2]
  before = env.state_dict()
  for _ in range(2):
    with pytest.raises(RuntimeError, match=r"the episodes of worlds \[1, 3\] ended; reset them before the next step"):
      env.step(actions(env, 2))
  assert assert_rows_equal(before, env.state_dict(), [0, 1, 2, 3], 4) > 20
  env.reset(env_ids=[1])
  with pytest.raises(RuntimeError, match=r"\[3\]"):
    env.step(actions(env, 2))
  env.reset(env_ids=[3])
  env.step(actions(env, 2))
  assert env.episode_length_buf.tolist() == [3, 1, 3, 1]


def test_without_auto_reset_the_terminal_observation_is_returned(make: Make) -> None:
  manual, automatic = make(auto_reset=False), make()
  for env in (manual, automatic):
    env.reset()
    end(env, 2)
  obs, reward, *_ = manual.step(actions(manual, 0))
  new, same_reward, *_ = automatic.step(actions(automatic, 0))
  assert torch.equal(reward, same_reward)
  joints = manual.scene["robot"].data.joint_pos[2]
  assert not torch.equal(joints, automatic.scene["robot"].data.joint_pos[2])
  assert not torch.equal(obs["critic"][2], new["critic"][2])
  assert torch.equal(manual.action_manager.action[2], actions(manual, 0)[2])
  assert not automatic.action_manager.action[2].any()


def test_a_partial_reset_leaves_all_that_other_worlds_remember_bit_identical(make: Make, engine: str) -> None:
  env = make(engine=engine)
  for step in range(7):
    env.step(actions(env, step))
  before, obs = env.state_dict(), env.get_observations()
  after_obs, _ = env.reset(env_ids=[1])
  compared = assert_rows_equal(before, env.state_dict(), [0, 2, 3], 4)
  assert compared > 25
  for group in obs:
    assert torch.equal(after_obs[group][[0, 2, 3]], obs[group][[0, 2, 3]])
    assert not torch.equal(after_obs[group][1], obs[group][1])
  assert env.episode_length_buf.tolist() == [7, 0, 7, 7]
  assert not env.action_manager.action[1].any()


WORLDS: list[tuple[Any, list[int]]] = [
  ([1, 3], [1, 3]),
  ((2,), [2]),
  (torch.tensor([0, 2]), [0, 2]),
  (torch.tensor([0, 2], dtype=torch.int32), [0, 2]),
  (torch.tensor([False, True, False, True]), [1, 3]),
  ([False, True, False, True], [1, 3]),
  (np.array([3, 0]), [0, 3]),
  (range(3), [0, 1, 2]),
  ([1, 1], [1]),
  ([], []),
  (torch.zeros(0, dtype=torch.int64), []),
  (torch.zeros(4, dtype=torch.bool), []),
  (None, [0, 1, 2, 3]),
]
NO_WORLDS: list[tuple[Any, str]] = [
  ([0, 4], r"env_ids must be in \[0, 3\], got \[0, 4\]"),
  ([-1], r"env_ids must be in \[0, 3\], got \[-1\]"),
  (torch.ones(3, dtype=torch.bool), r"env_ids must be a whole number, got \[True, True, True\]"),
  ([0.5], r"env_ids must be a whole number"),
  ([[0, 1]], r"env_ids must be a whole number"),
]


def test_worlds_are_named_by_numbers_or_by_a_mask_and_others_refused_before_anything_changes(make: Make) -> None:
  env = make()
  for selection, worlds in WORLDS:
    env.step(actions(env, 0))
    before = env.state_dict()
    obs, info = env.reset(env_ids=selection)
    assert (info, obs["actor"].shape) == ({}, (4, 16))
    assert [world for world in range(4) if env.episode_length_buf[world] == 0] == worlds
    assert_rows_equal(before, env.state_dict(), [world for world in range(4) if world not in worlds], 4)
  env.step(actions(env, 0))
  before = env.state_dict()
  for selection, message in NO_WORLDS:
    with pytest.raises(ValueError, match=message):
      env.reset(env_ids=selection, seed=3)
    after = env.state_dict()
    assert_rows_equal(before, after, [0, 1, 2, 3], 4)
    assert torch.equal(before["rng"], after["rng"])
    assert env.seed == 7


def test_the_default_event_puts_worlds_into_their_default_state(make: Make) -> None:
  cfg = hopper_cfg()
  cfg.events = type(cfg)(decimation=1, scene=cfg.scene).events
  env = make(cfg)
  for step in range(3):
    env.step(actions(env, step))
  env.reset(env_ids=[0, 2])
  data = env.scene["robot"].data
  expected = data.default_root_state[0, :3] + env.scene.env_origins
  torch.testing.assert_close(data.root_link_pos_w[[0, 2]], expected[[0, 2]])
  assert torch.equal(data.joint_pos[0], data.default_joint_pos[0])
  assert not torch.equal(data.joint_pos[1], data.default_joint_pos[0])
  assert env.scene.env_origins.unique(dim=0).shape[0] == 4


class Book(RecorderTerm):
  """Writes down what it sees of worlds that are about to be reset."""

  pages: list[tuple[int, list[float], float, bool, bool]]

  def __init__(self, env: ManagerBasedRlEnv) -> None:
    super().__init__(env)
    self.pages, self.closed = [], 0
    self.fresh: list[list[int]] = []

  def pre_reset(self, mask: torch.Tensor) -> None:
    env = self.env
    for world in mask.nonzero().flatten().tolist():
      done = env.termination_manager.terminated[world].item(), env.termination_manager.time_outs[world].item()
      action, reward = env.action_manager.action[world].tolist(), env.reward_manager.reward[world].item()
      self.pages.append((world, action, reward, *done))

  def post_reset(self, mask: torch.Tensor) -> None:
    self.fresh.append(mask.nonzero().flatten().tolist())

  def close(self) -> None:
    self.closed += 1


@pytest.mark.parametrize("auto_reset", [True, False])
def test_recorders_see_last_action_reward_and_reason_of_terminal_steps(make: Make, auto_reset: bool) -> None:
  env = make(auto_reset=auto_reset, recorders={"book": RecorderTermCfg(Book)})
  book = env.recorder_manager.get_term("book")
  assert isinstance(book, Book)
  book.pages.clear()
  env.step(actions(env, 0))
  end(env, 2)
  _, reward, *_ = env.step(actions(env, 1))
  if not auto_reset:
    assert book.pages == []
    env.reset(env_ids=[2])
  assert book.pages == [(2, actions(env, 1)[2].tolist(), reward[2].item(), True, False)]
  assert book.fresh[-1] == [2]
  env.close()
  env.close()
  assert book.closed == 1
