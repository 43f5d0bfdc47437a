"""Terminations: unions, reasons and counts."""

from typing import Any

import torch
from mjlab_managers import TerminationManager, TerminationTermCfg


def above(env: Any, *, limit: float, column: int = 0) -> torch.Tensor:
  return env.values[:, column] > limit


def build(env: Any) -> TerminationManager:
  limits = {"late": 8.0, "fell": 12.0, "never": 1e9}
  terms = {
    name: TerminationTermCfg(above, params={"limit": limit}, time_out=name == "late") for name, limit in limits.items()
  }
  return TerminationManager(terms, env)


def test_terminations_and_time_outs_are_kept_apart_and_both_reported(env):
  manager = build(env)
  assert manager.compute().tolist() == [False, False, True, True]
  assert manager.time_outs.tolist() == [False, False, True, True]
  assert manager.terminated.tolist() == [False, False, False, True]
  assert manager.get_term("fell").tolist() == [False, False, False, True]
  assert manager.terms(3) == [("late", [1.0]), ("fell", [1.0]), ("never", [0.0])]
  names, values = manager.step_terms
  assert names == ["late", "fell", "never"]
  for column, name in enumerate(names):
    assert torch.equal(values[:, column], manager.get_term(name))
  memory = values.data_ptr()
  manager.compute()
  assert manager.step_terms[1].data_ptr() == memory


def test_reasons_are_counted_over_the_interval_and_nan_while_no_episode_ended(env, logged):
  manager = build(env)
  values = env.values.clone()
  env.values.zero_()
  manager.compute()
  assert {str(value) for value in logged(manager).values()} == {"nan"}
  env.values.copy_(values)
  manager.compute()
  manager.compute()
  assert logged(manager) == {
    "Episode_Termination/fell": 2.0,
    "Episode_Termination/never": 0.0,
    "Episode_Termination/late": 4.0,
  }
  manager.clear_log()
  assert {str(value) for value in logged(manager).values()} == {"nan"}


def test_time_out_may_be_changed_on_the_host(env):
  manager = build(env)
  manager.sync()
  manager.get_term_cfg("late").time_out = False
  manager.sync()
  manager.compute()
  assert not env.recaptures
  assert manager.terminated.tolist() == [False, False, True, True]
  assert not manager.time_outs.any()


def test_a_step_asks_the_device_nothing_and_needs_few_operations(env, dispatched):
  manager = build(env)
  # Three comparisons of the terms' own.
  assert len(dispatched(manager.compute)) <= 3 + 6
