"""Curricula: evaluated in the step, logged as they stand."""

from typing import Any

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_managers import CurriculumManager, CurriculumTermCfg, ManagerTermBase, RewardManager, RewardTermCfg


class WeightSchedule(ManagerTermBase):
  """Sets a reward's weight by the step counter, on the device."""

  def __init__(self, env: Any, *, reward: str, stages: list[tuple[int, float]]) -> None:
    super().__init__(env)
    self._steps = torch.tensor([step for step, _ in stages])
    self._values = torch.tensor([value for _, value in stages])
    self._weight = env.reward_manager.weight(reward)

  def __call__(self, mask: torch.Tensor) -> torch.Tensor:
    stage = (self._steps <= self.env.common_step_counter).sum() - 1
    return self._weight.copy_(self._values.index_select(0, stage.reshape(1))[0])


def test_a_reward_weight_follows_the_step_counter_inside_the_step(env, logged, dispatched):
  env.reward_manager = RewardManager(
    {"r": RewardTermCfg(lambda env: torch.ones(env.num_envs), weight=0.0)}, env, scale_by_dt=False
  )
  params = {"reward": "r", "stages": [(0, 0.0), (10, 2.0), (20, 5.0)]}
  manager = CurriculumManager({"weight": CurriculumTermCfg(WeightSchedule, params=params)}, env)
  rewards = []
  for step in range(0, 30, 5):
    env.common_step_counter.fill_(step)
    manager.compute(env.mask())
    env.reward_manager.sync()
    rewards.append(env.reward_manager.compute()[0].item())
  assert rewards == [0, 0, 2, 2, 5, 5]
  assert logged(manager) == {"Curriculum/weight": 5.0}
  none = env.mask()
  dispatched(lambda: manager.compute(none))


def test_states_are_logged_by_key_as_last_seen(env, logged):
  def levels(env: Any, mask: torch.Tensor) -> dict[str, torch.Tensor]:
    return {"mean": env.values[:, 0].mean(), "count": mask.sum()}

  silent = CurriculumTermCfg(lambda env, mask: None)
  manager = CurriculumManager({"terrain": CurriculumTermCfg(levels), "silent": silent}, env)
  assert str(logged(manager)["Curriculum/terrain/mean"]) == "nan"
  manager.compute(env.mask(1))
  manager.compute(env.mask(1, 2))
  assert logged(manager) == {"Curriculum/terrain/mean": 7.5, "Curriculum/terrain/count": 2.0}


def test_a_term_that_asks_for_indices_runs_eagerly_and_may_return_numbers(env, logged):
  def progress(env: Any, env_ids: torch.Tensor) -> float:
    return float(len(env_ids))

  def shares(env: Any, env_ids: torch.Tensor) -> dict[str, float]:
    return {"count": len(env_ids), "share": len(env_ids) / env.num_envs}

  manager = CurriculumManager({"p": CurriculumTermCfg(progress), "s": CurriculumTermCfg(shares)}, env)
  manager.compute(env.mask())
  assert logged(manager) == {}
  manager.compute(env.mask(0, 3))
  assert logged(manager) == {"Curriculum/p": 2.0, "Curriculum/s/count": 2.0, "Curriculum/s/share": 0.5}
  assert env.eager == ["curriculum 'p'", "curriculum 's'"] * 2


def test_a_number_returned_inside_the_step_is_an_error(env):
  with pytest.raises(ConfigError, match=r"must return None, a 0-d tensor or a dict of them, returned float 1.0"):
    CurriculumManager({"c": CurriculumTermCfg(lambda env, mask: 1.0)}, env)
