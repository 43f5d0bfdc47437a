"""Metrics: reductions over episodes."""

from typing import Any

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_managers import MetricsManager, MetricsTermCfg


def column(env: Any) -> torch.Tensor:
  return env.values[:, 0]


def all_reductions(**options: Any) -> dict[str, MetricsTermCfg | None]:
  return {name: MetricsTermCfg(column, reduce=name, **options) for name in ("last", "mean", "max", "sum")}


def test_each_reduction_means_what_it_says(env, logged):
  manager = MetricsManager(all_reductions(), env)
  for value in (3.0, -1.0, 1.0):
    env.values[:] = value
    manager.compute()
  manager.reset(env.mask(0))
  log = {name.split("/")[-1]: value for name, value in logged(manager).items() if name.startswith("Episode")}
  assert log == {"last": 1.0, "mean": 1.0, "max": 3.0, "sum": 3.0}
  env.values[:] = -5.0
  manager.compute()
  manager.clear_log()
  manager.reset(env.mask(0))
  assert logged(manager)["Episode_Metrics/max"] == -5.0


def test_an_episode_without_a_step_is_left_out(env, logged):
  manager = MetricsManager(all_reductions(), env)
  everyone = env.mask(0, 1, 2, 3)
  manager.reset(everyone)
  assert {str(value) for value in logged(manager).values()} == {"nan"}
  env.values[:] = 2.0
  manager.compute()
  manager.reset(env.mask(1))
  manager.reset(env.mask(1, 2))
  log = logged(manager)
  assert [log[f"Episode_Metrics/{name}"] for name in ("last", "mean", "max", "sum")] == [2.0] * 4


def test_a_signal_between_zero_and_one_has_its_mean_there_also_from_substeps(env, logged):
  manager = MetricsManager(all_reductions(per_substep=True), env)
  for _ in range(7):
    for substep in range(4):
      env.values[:] = float(substep == 0)
      manager.compute_substep()
    manager.compute()
  manager.reset(env.mask(0, 1))
  log = logged(manager)
  assert log["Episode_Metrics/mean"] == pytest.approx(0.25)
  assert log["Episode_Metrics/max"] == pytest.approx(0.25)
  assert log["Episode_Metrics/sum"] == pytest.approx(7 * 0.25)


def test_a_value_that_is_no_number_counts_as_zero_and_is_counted(env, logged):
  manager = MetricsManager({"m": MetricsTermCfg(column)}, env)
  env.values[1, 0] = torch.nan
  manager.compute()
  manager.reset(env.mask(1))
  assert logged(manager) == {"Episode_Metrics/m": 0.0, "Nonfinite/metrics/m": 1.0}


def test_an_unknown_reduction_gets_a_suggestion(env):
  with pytest.raises(ConfigError, match=r"term 'm': reduce 'men' does not exist. Nearest: mean"):
    MetricsManager({"m": MetricsTermCfg(column, reduce="men")}, env)  # type: ignore


def test_a_step_asks_the_device_nothing(env, dispatched):
  manager = MetricsManager({**all_reductions(), "sub": MetricsTermCfg(column, per_substep=True)}, env)
  mask = env.mask(1)
  dispatched(manager.compute_substep)
  assert len(dispatched(manager.compute)) <= 12
  dispatched(lambda: manager.reset(mask))


def test_the_value_of_the_last_step_can_be_asked_for_by_name(env):
  manager = MetricsManager(all_reductions(), env)
  for value in (3.0, 4.0):
    env.values[:] = value
    manager.compute()
  assert {name: manager.get_value(name).tolist() for name in ("last", "mean", "max", "sum")} == dict.fromkeys(
    ("last", "mean", "max", "sum"), [4.0] * env.num_envs
  )
  with pytest.raises(KeyError, match="Nearest: mean"):
    manager.get_value("meen")
