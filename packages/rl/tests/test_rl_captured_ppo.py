"""PPO that a GPU runs as a graph, against rsl-rl's own."""

import contextlib
import copy
import io
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from mjlab_rl import RslRlModelCfg, RslRlPpoAlgorithmCfg
from mjlab_rl.onpolicy.captured_ppo import CapturedPPO
from rsl_rl.algorithms import PPO
from tensordict import TensorDict

NEEDS_GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
DEVICES = pytest.mark.parametrize("device", ["cpu", pytest.param("cuda:0", marks=NEEDS_GPU)])
WORLDS, STEPS, OBSERVATIONS, ACTIONS = 16, 8, 5, 3


def construct(kind: type[PPO], device: str, **settings: Any) -> PPO:
  critic = RslRlModelCfg(hidden_dims=(32, 32), obs_normalization=True)
  actor = replace(critic, distribution_cfg={"class_name": "GaussianDistribution", "init_std": 1.0})
  algorithm = RslRlPpoAlgorithmCfg(**settings).to_rsl_rl() | {"class_name": kind}
  cfg = {"actor": actor.to_rsl_rl(), "critic": critic.to_rsl_rl(), "algorithm": algorithm}
  groups = {"obs_groups": {"actor": ["policy"], "critic": ["policy"]}, "num_steps_per_env": STEPS, "multi_gpu": None}
  env: Any = SimpleNamespace(num_envs=WORLDS, num_actions=ACTIONS)
  torch.manual_seed(0)
  with contextlib.redirect_stdout(io.StringIO()):
    return PPO.construct_algorithm(seen(0, device), env, copy.deepcopy(cfg) | groups, device)


def seen(seed: int, device: str) -> TensorDict:
  values = torch.randn(WORLDS, OBSERVATIONS, generator=torch.Generator().manual_seed(seed))
  return TensorDict({"policy": values.to(device)}, batch_size=[WORLDS])


def roll_out(learner: PPO, seed: int, device: str) -> None:
  """Fill the storage with the learner's actions, which are rewarded for being close to an observation."""
  with torch.no_grad():
    for step in range(STEPS):
      observations = seen(1000 * seed + step, device)
      actions = learner.act(observations)
      rewards = -(actions[:, 0] - observations["policy"][:, 0]).square()
      dones = (torch.arange(WORLDS, device=device) + step) % 7 == 0
      learner.process_env_step(observations, rewards, dones, {})
    learner.compute_returns(seen(1000 * seed + STEPS, device))


def compare(device: str, tolerance: float, updates: int = 25, **settings: Any) -> None:
  """Run updates with both, and hold weights, losses and learning rates of one against those of the other."""
  torch.manual_seed(1)
  own, reference = construct(CapturedPPO, device, **settings), construct(PPO, device, **settings)
  rates = set()
  for update in range(updates):
    losses = []
    for learner in (own, reference):
      torch.manual_seed(update)
      roll_out(learner, update, device)
      losses.append(learner.update())
    assert losses[0] == pytest.approx(losses[1], rel=tolerance, abs=tolerance), update
    assert own.learning_rate == pytest.approx(reference.learning_rate, rel=1e-5), update
    rates.add(round(own.learning_rate, 9))
  for ours, theirs in ((own.actor, reference.actor), (own.critic, reference.critic)):
    for name, value in ours.state_dict().items():
      torch.testing.assert_close(
        value, theirs.state_dict()[name], rtol=1e-3, atol=1e-4, msg=lambda m, n=name: f"{n}: {m}"
      )
  assert (len(rates) > min(2, updates // 6)) == (settings.get("schedule", "adaptive") == "adaptive")


SETTINGS = [
  {},
  {"schedule": "fixed", "use_clipped_value_loss": False, "normalize_advantage_per_mini_batch": True},
  {"optimizer": "adamw", "entropy_coef": 0.01, "max_grad_norm": 0.1},
  {"optimizer": "sgd", "schedule": "fixed"},
]


@pytest.mark.parametrize("settings", SETTINGS, ids=["adaptive", "fixed", "adamw", "sgd"])
def test_updates_are_those_of_rsl_rl(settings: dict[str, Any]) -> None:
  compare("cpu", 1e-7, updates=8 if settings else 12, **settings)


@NEEDS_GPU
@pytest.mark.parametrize("settings", SETTINGS[:3], ids=["adaptive", "fixed", "adamw"])
def test_fifty_updates_in_a_graph_on_a_gpu_are_those_of_rsl_rl(settings: dict[str, Any]) -> None:
  compare("cuda:0", 1e-3, **settings)


def tensors(learner: PPO) -> Iterator[torch.Tensor]:
  """Yield what a step reads or writes, except what it makes."""
  for network in (learner.actor, learner.critic):
    yield from network.parameters()
    yield from network.buffers()
  for state in learner.optimizer.state.values():
    yield from state.values()
  storage = learner.storage
  yield from (storage.observations["policy"], storage.actions, storage.actions_log_prob)
  yield from (storage.values, storage.returns, storage.advantages, *(storage.distribution_params or ()))


@DEVICES
def test_tensors_keep_their_memory_so_that_a_step_is_recorded_once(device: str) -> None:
  learner = construct(CapturedPPO, device)
  assert isinstance(learner, CapturedPPO)
  found = []
  for update in range(6):
    roll_out(learner, update, device)
    learner.update()
    addresses = [tensor.data_ptr() for tensor in tensors(learner)]
    found.append((addresses, learner._differentiate._graph, learner._apply._graph))
  assert all(one == found[0] for one in found)
  assert (found[0][1] is None) == (device == "cpu")


@NEEDS_GPU
def test_a_restored_learner_records_again() -> None:
  """The optimiser's state gets other memory, which the graphs of before do not read."""
  learner, reference = (construct(kind, "cuda:0") for kind in (CapturedPPO, PPO))
  for update in range(6):
    for each in (learner, reference):
      torch.manual_seed(update)
      roll_out(each, update, "cuda:0")
      each.update()
      if update == 2:
        each.load(copy.deepcopy(each.save()), None, strict=True)
  torch.testing.assert_close(learner.actor.state_dict(), reference.actor.state_dict(), rtol=1e-3, atol=1e-4)


@DEVICES
def test_a_restored_learner_continues_as_the_saved_one_with_and_without_a_gpu(device: str) -> None:
  first = construct(CapturedPPO, device)
  for update in range(4):
    roll_out(first, update, device)
    first.update()
  saved = copy.deepcopy(first.save())
  group = saved["optimizer_state_dict"]["param_groups"][0]
  assert type(group["lr"]) is float
  assert not group["capturable"]
  assert not group["fused"]
  second, third = construct(CapturedPPO, device), construct(PPO, "cpu")
  for learner in (second, third):
    learner.load(copy.deepcopy(saved), None, strict=True)
  for update in range(4, 8):
    for learner in (first, second):
      torch.manual_seed(update)
      roll_out(learner, update, device)
      learner.update()
  torch.testing.assert_close(second.actor.state_dict(), first.actor.state_dict(), rtol=1e-4, atol=1e-5)
  roll_out(third, 4, "cpu")
  assert third.update()["value"] > 0.0
