"""Iterations in which only the critic learns."""

from pathlib import Path

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_rl import MjlabOnPolicyRunner
from rl_learners import agent, assert_resumes_exactly, pretend_two_processes, runner


def warming(warmup: int, class_name: str) -> MjlabOnPolicyRunner:
  cfg = agent(critic_warmup=warmup)
  cfg.algorithm.class_name = class_name
  return runner(None, cfg)


def weights(run: MjlabOnPolicyRunner, name: str) -> torch.Tensor:
  return torch.cat([value.flatten().double() for value in run.networks[name].state_dict().values()])


@pytest.mark.parametrize("class_name", ["PPO", "rsl_rl.algorithms:PPO"])
def test_the_actor_is_held_while_the_critic_learns_as_usual(class_name: str) -> None:
  usual = warming(0, class_name)
  usual.learn(1)
  run = warming(2, class_name)
  before, rate = weights(run, "actor"), run.alg.learning_rate
  run.learn(1)
  assert torch.equal(weights(run, "actor"), before)
  assert torch.equal(weights(run, "critic"), weights(usual, "critic"))
  run.learn(1)
  assert torch.equal(weights(run, "actor"), before)
  assert not torch.equal(weights(run, "critic"), weights(usual, "critic"))
  assert run.alg.learning_rate == rate
  state = run.alg.optimizer.state
  assert all(value.eq(0).all() for p in run.networks["actor"].parameters() for value in state[p].values())
  run.learn(1)
  assert not torch.equal(weights(run, "actor"), before)


def test_the_normaliser_of_the_actor_is_held_in_runs_of_several_processes(monkeypatch: pytest.MonkeyPatch) -> None:
  pretend_two_processes(monkeypatch)
  run = warming(1, "PPO")
  before = weights(run, "actor")
  run.learn(1)
  assert torch.equal(weights(run, "actor"), before)
  assert int(run.networks["critic"].state_dict()["obs_normalizer.count"]) > 0
  run.learn(1)
  assert int(run.networks["actor"].state_dict()["obs_normalizer.count"]) > 0


def test_a_run_that_is_resumed_during_the_warmup_equals_an_uninterrupted_one(tmp_path: Path) -> None:
  assert_resumes_exactly(lambda folder: runner(folder, agent(critic_warmup=3)), tmp_path)


def test_encoders_that_the_critic_shares_cannot_be_held() -> None:
  cfg = agent(critic_warmup=1)
  cfg.algorithm.share_cnn_encoders = True
  with pytest.raises(ConfigError, match="critic_warmup holds the actor, whose encoders the critic shares"):
    runner(None, cfg)
