"""Iterations in which only the critic learns."""

from pathlib import Path
from typing import Any

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_rl import MjlabOnPolicyRunner, RslRlOnPolicyRunnerCfg
from rl_learners import agent, assert_resumes_exactly, runner


def warming(warmup: int, class_name: str) -> RslRlOnPolicyRunnerCfg:
  cfg = agent(critic_warmup=warmup)
  cfg.algorithm.class_name = class_name
  return cfg


def weights(run: MjlabOnPolicyRunner, name: str) -> dict[str, torch.Tensor]:
  return {key: value.clone() for key, value in run.networks[name].state_dict().items()}


def same(a: dict[str, Any], b: dict[str, Any]) -> bool:
  return all(torch.equal(a[key], b[key]) for key in a)


@pytest.mark.parametrize("class_name", ["PPO", "rsl_rl.algorithms:PPO"])
def test_the_actor_is_held_while_the_critic_learns_as_usual(class_name: str) -> None:
  usual = runner(None, warming(0, class_name))
  usual.learn(1)
  run = runner(None, warming(2, class_name))
  before = {name: weights(run, name) for name in ("actor", "critic")}
  rate = run.alg.learning_rate
  run.learn(1)
  assert same(weights(run, "actor"), before["actor"])
  assert same(weights(run, "critic"), weights(usual, "critic"))
  run.learn(1)
  assert same(weights(run, "actor"), before["actor"])
  assert not same(weights(run, "critic"), weights(usual, "critic"))
  assert run.alg.learning_rate == rate
  state = run.alg.optimizer.state
  assert all(value.eq(0).all() for p in run.networks["actor"].parameters() for value in state[p].values())
  run.learn(1)
  assert not same(weights(run, "actor"), before["actor"])


def test_a_run_that_is_resumed_during_the_warmup_equals_an_uninterrupted_one(tmp_path: Path) -> None:
  assert_resumes_exactly(lambda folder: runner(folder, agent(critic_warmup=3)), tmp_path)


def test_encoders_that_the_critic_shares_cannot_be_held() -> None:
  cfg = agent(critic_warmup=1)
  cfg.algorithm.share_cnn_encoders = True
  with pytest.raises(ConfigError, match="critic_warmup holds the actor, whose encoders the critic shares"):
    runner(None, cfg)
