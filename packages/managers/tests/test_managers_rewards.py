"""Rewards: weighing, switching, counting and logging."""

from typing import Any

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_managers import ManagerTermBase, RewardManager, RewardTermCfg


def one(env: Any) -> torch.Tensor:
  return torch.ones(env.num_envs)


def column(env: Any, *, index: int = 0) -> torch.Tensor:
  return env.values[:, index]


def test_the_reward_is_the_weighted_sum_per_second(env):
  terms = {"one": RewardTermCfg(one, weight=2.0), "column": RewardTermCfg(column, weight=-0.5, params={"index": 1})}
  expected = 2.0 - 0.5 * env.values[:, 1]
  torch.testing.assert_close(RewardManager(terms, env).compute(), expected * env.step_dt)
  torch.testing.assert_close(RewardManager(terms, env, scale_by_dt=False).compute(), expected)


def test_a_constant_reward_of_one_over_a_full_episode_logs_its_weight(env, logged):
  manager = RewardManager({"one": RewardTermCfg(one, weight=3.0)}, env)
  for _ in range(env.max_episode_length):
    manager.compute()
  manager.reset(env.mask(0, 2))
  assert logged(manager)["Episode_Reward/one"] == pytest.approx(3.0)
  assert manager.episode_sums[:, 0].tolist() == pytest.approx([0.0, 3.0, 0.0, 3.0])


@pytest.mark.parametrize("weight", [float("nan"), float("inf")])
def test_a_weight_that_is_no_number_is_refused_at_build_and_later(env, weight):
  with pytest.raises(ConfigError, match=r"term 'one': weight must be (finite|a number)"):
    RewardManager({"one": RewardTermCfg(one, weight=weight)}, env)
  manager = RewardManager({"one": RewardTermCfg(one, weight=1.0)}, env, scale_by_dt=False)
  manager.get_term_cfg("one").weight = weight
  with pytest.raises(ConfigError, match=r"term 'one': weight must be (finite|a number)"):
    manager.sync()
  assert manager.compute().tolist() == [1.0] * 4


def test_the_log_is_the_mean_over_all_episodes_of_the_interval_and_nan_without_any(env, logged):
  manager = RewardManager({"column": RewardTermCfg(column, weight=1.0)}, env)
  manager.compute()
  assert str(logged(manager)["Episode_Reward/column"]) == "nan"
  manager.reset(env.mask(1))
  manager.reset(env.mask(2, 3))
  env.episode_length_buf[0] = 0
  manager.reset(env.mask(0))
  assert logged(manager)["Episode_Reward/column"] == pytest.approx((5 + 10 + 15) / 3 * env.step_dt)
  manager.clear_log()
  assert str(logged(manager)["Episode_Reward/column"]) == "nan"


def test_a_value_that_is_no_number_counts_as_zero_and_is_counted(env, logged):
  terms = {"bad": RewardTermCfg(column, weight=1.0), "one": RewardTermCfg(one, weight=1.0)}
  manager = RewardManager(terms, env, scale_by_dt=False)
  env.values[0, 0], env.values[1, 0] = torch.nan, torch.inf
  assert manager.compute().tolist() == [1.0, 1.0, 11.0, 16.0]
  manager.reset(env.mask(0))
  log = logged(manager)
  assert log["Nonfinite/reward/bad"] == 2.0
  assert str(log["Nonfinite/reward/one"]) == "nan"
  assert log["Episode_Reward/bad"] == 0.0


def test_a_weight_of_zero_is_not_evaluated_and_can_be_switched_on_and_off(env):
  calls = []

  def counted(env: Any) -> torch.Tensor:
    calls.append(1)
    return torch.ones(env.num_envs)

  manager = RewardManager({"r": RewardTermCfg(counted, weight=0.0)}, env, scale_by_dt=False)
  calls.clear()
  manager.sync()
  assert manager.compute().tolist() == [0.0] * 4
  assert not calls
  assert not env.recaptures
  manager.get_term_cfg("r").weight = 2.0
  manager.sync()
  assert "switched on or off: r" in env.recaptures[-1]
  assert manager.compute().tolist() == [2.0] * 4
  manager.get_term_cfg("r").weight = 3.0
  manager.sync()
  assert len(env.recaptures) == 1
  assert manager.compute().tolist() == [3.0] * 4
  manager.get_term_cfg("r").weight = 0.0
  manager.sync()
  assert len(env.recaptures) == 2
  assert manager.compute().tolist() == [0.0] * 4


def test_a_weight_written_on_the_device_counts_and_is_saved(env):
  def build() -> tuple[RewardManager, torch.Tensor]:
    manager = RewardManager({"r": RewardTermCfg(one, weight=0.0)}, env, scale_by_dt=False)
    return manager, manager.weight("r")

  manager, weight = build()
  weight.fill_(4.0)
  manager.sync()
  assert manager.compute().tolist() == [4.0] * 4
  other, weight = build()
  other.load_state_dict(manager.state_dict())
  assert weight == 4.0
  other.sync()
  assert other.compute().tolist() == [4.0] * 4


def test_a_saved_weight_yields_to_the_config_unless_a_curriculum_has_it(env):
  def build(weight: float) -> RewardManager:
    terms = {name: RewardTermCfg(one, weight=weight) for name in ("plain", "led")}
    manager = RewardManager(terms, env, scale_by_dt=False)
    manager.weight("led")
    return manager

  saved = build(1.0)
  saved.weight("led").fill_(10.0)
  resumed = build(-0.25)
  resumed.load_state_dict(saved.state_dict())
  resumed.sync()
  assert resumed.compute().tolist() == [9.75] * 4
  assert resumed.get_term_cfg("plain").weight == -0.25


def test_terms_of_a_double_precision_engine_give_float32_rewards(make_env):
  env = make_env(dtype=torch.float64)
  reward = RewardManager({"c": RewardTermCfg(column, weight=1.0)}, env).compute()
  assert reward.dtype is torch.float32


def test_viewers_get_every_term_of_one_world(env):
  manager = RewardManager({"c": RewardTermCfg(column, weight=2.0)}, env)
  manager.compute()
  assert manager.terms(1) == [("c", [10.0])]
  assert "weight" in manager.describe()


def test_a_step_asks_the_device_nothing_and_needs_few_operations(env, dispatched):
  class Stateful(ManagerTermBase):
    def __init__(self, env: Any) -> None:
      super().__init__(env)
      self.peak = self.state()

    def __call__(self) -> torch.Tensor:
      return self.peak

  terms = {f"t{i}": RewardTermCfg(column, weight=1.0) for i in range(15)}
  manager, mask = RewardManager({**terms, "s": RewardTermCfg(Stateful, weight=1.0)}, env), env.mask(1, 3)
  address = manager.reward.data_ptr()
  assert len(dispatched(manager.compute)) <= 9
  assert len(dispatched(lambda: manager.reset(mask))) <= 10
  assert manager.compute().data_ptr() == address
