"""Updates of off-policy learning: losses against slow references, waits, processes, and a custom algorithm."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mjlab_rl
import numpy as np
import pytest
import torch
from mjlab_core import seed_everything
from mjlab_rl import Console, TaskCfg, train
from mjlab_rl.offpolicy.algorithm import action_bounds
from mjlab_rl.offpolicy.config import SacCfg
from rl_learners import Waits, assert_learned_the_same, pretend_two_processes
from rl_point_env import PointEnv, PointEnvCfg
from test_rl_offpolicy import agent_of, runner_of, slow_projection
from torch import distributed


def filled(steps: int = 30, preset: str = "fastsac", **algorithm: Any) -> Any:
  """Return an algorithm with some steps in its memory, terminations and time-outs among them."""
  torch.manual_seed(0)
  runner = runner_of(agent_of(preset, **algorithm), noise=0.4)
  obs = runner.env.get_observations()
  for _ in range(steps):
    obs, *_ = runner.algorithm.collect(runner.env, obs)
  return runner.algorithm


SUPPORT = np.linspace(-3.0, 3.0, 11)
SETTINGS: dict[str, Any] = {"n_step": 2, "num_atoms": 11, "value_limit": 3.0, "temperature": 0.3}


def critic_loss(batch: Any, later: np.ndarray, logs: np.ndarray, log_prob: np.ndarray, combine: str) -> float:
  """Return the loss of two critics for the probabilities of the next step and the present logarithms."""
  loss = 0.0
  for i, (reward, discount) in enumerate(zip(batch.reward.tolist(), batch.discount.tolist(), strict=True)):
    # The value of a stochastic policy contains its entropy.
    values = reward + discount * (SUPPORT - 0.3 * log_prob[i])
    least = int((later[:, i] @ SUPPORT).argmin())
    for critic in range(2):
      goal = slow_projection(later[critic if combine == "mean" else least, i], values, SUPPORT)
      loss -= float(goal @ logs[critic, i]) / 32
  return loss


@pytest.mark.parametrize("combine", ["mean", "min"])
def test_losses_are_those_of_a_slow_reference(combine: str) -> None:
  algorithm = filled(combine=combine, **SETTINGS)
  batch = algorithm.sample()
  assert bool((batch.discount == 0.0).any())

  def drawn(obs: torch.Tensor) -> tuple[torch.Tensor, np.ndarray]:
    torch.manual_seed(7)
    action, log_prob = algorithm.actor.squash.sample_with_log_prob(algorithm.actor.output(algorithm.of_actor(obs)))
    return action, log_prob.double().numpy()

  def logits(critic: Any, obs: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
    return critic.logits(algorithm.of_critic(obs), action).double()

  with torch.no_grad():
    action, log_prob = drawn(batch.next_obs)
    later = logits(algorithm.target, batch.next_obs, action).softmax(-1).numpy()
    logs = logits(algorithm.critic, batch.obs, batch.action).log_softmax(-1).numpy()
  torch.manual_seed(7)
  algorithm._update_critic(batch)
  expected = critic_loss(batch, later, logs, log_prob, combine)
  assert float(algorithm.figures()["critic_loss"]) == pytest.approx(expected, rel=1e-4)

  temperature = float(algorithm.log_temperature.detach().exp())
  with torch.no_grad():
    action, log_prob = drawn(batch.obs)
    value = (logits(algorithm.critic, batch.obs, action).softmax(-1).numpy() @ SUPPORT).T
  combined = value.mean(1) if combine == "mean" else value.min(1)
  torch.manual_seed(7)
  algorithm._update_policy(batch)
  expected = float((temperature * log_prob - combined).mean())
  assert float(algorithm.figures()["policy_loss"]) == pytest.approx(expected, rel=1e-4)


def test_critics_with_batch_normalisation_see_present_and_next_steps_as_one_batch() -> None:
  """As CrossQ does (arXiv:1902.05605): apart, the two halves would be normalised by different moments."""
  algorithm = filled(preset="flashsac", batch_size=32, **SETTINGS)
  batch = algorithm.sample()
  with torch.no_grad():
    algorithm.actor.eval()
    torch.manual_seed(7)
    output = algorithm.actor.output(algorithm.of_actor(batch.next_obs))
    action, log_prob = algorithm.actor.squash.sample_with_log_prob(output)
    obs = torch.cat((algorithm.of_critic(batch.obs), algorithm.of_critic(batch.next_obs)))
    actions = torch.cat((batch.action, action))
    later = algorithm.target.train().logits(obs, actions).double().softmax(-1).numpy()[:, 32:]
    logs = algorithm.critic.train().logits(obs, actions).double().log_softmax(-1).numpy()[:, :32]
    apart = algorithm.critic.logits(obs[:32], actions[:32]).double().log_softmax(-1).numpy()
  assert np.abs(apart - logs).max() > 1e-3
  torch.manual_seed(7)
  algorithm._update_critic(batch)
  expected = critic_loss(batch, later, logs, log_prob.double().numpy(), "min")
  assert float(algorithm.figures()["critic_loss"]) == pytest.approx(expected, rel=1e-4)


def test_the_temperature_follows_the_entropy() -> None:
  algorithm = filled(steps=1, temperature=0.1, target_entropy=0.5)

  def change(entropy: float) -> float:
    before = float(algorithm.log_temperature.detach())
    algorithm.optimizer.state.clear()
    algorithm._update_temperature(torch.full((8,), -entropy))
    return float(algorithm.log_temperature.detach()) - before

  assert change(0.2) > 0.0
  assert change(0.8) < 0.0
  assert change(0.5) == 0.0


@pytest.mark.parametrize("preset", ["fastsac", "flashsac"])
def test_weights_of_unit_layers_keep_their_norm_in_training(preset: str) -> None:
  algorithm = filled(preset=preset)
  for _ in range(3):
    algorithm.update()
  assert algorithm.rounds_done
  for network in (algorithm.actor, algorithm.critic):
    norms = [m.weight.norm(dim=-1) for m in network.modules() if isinstance(m, torch.nn.Linear)]
    for m in network.modules():
      if isinstance(m, torch.nn.BatchNorm1d):
        norms.append(torch.cat((m.weight, m.bias)).norm()[None] / m.num_features**0.5)
    assert torch.allclose(torch.cat(norms), torch.tensor(1.0), atol=1e-4) == (preset == "flashsac")


@pytest.mark.parametrize("preset", ["fastsac", "flashsac"])
def test_collection_and_updates_never_wait_for_the_device(monkeypatch: pytest.MonkeyPatch, preset: str) -> None:
  torch.manual_seed(0)
  runner = runner_of(agent_of(preset))
  algorithm = runner.algorithm
  obs = runner.env.get_observations()
  for _ in range(8):
    obs, *_ = algorithm.collect(runner.env, obs)
  # On a CPU torch's own optimiser reads its count of steps; on a GPU it is capturable.
  monkeypatch.setattr(algorithm.optimizer, "step", lambda: None)
  with Waits() as waits:
    for _ in range(4):
      obs, *_ = algorithm.collect(runner.env, obs)
      algorithm.update()
    algorithm.figures()
  assert algorithm.rounds_done
  assert waits.found == []
  with Waits() as waits:
    float(obs["actor"].sum())
  assert waits.found == ["aten._local_scalar_dense.default"]


@pytest.mark.parametrize("preset", ["fastsac", "flashsac"])
def test_two_processes_with_the_same_worlds_learn_what_one_learns(monkeypatch: pytest.MonkeyPatch, preset: str) -> None:
  def trained() -> dict[str, Any]:
    seed_everything(1)
    runner = runner_of(agent_of(preset, return_scaling=True), noise=0.2)
    runner.learn(3)
    return runner.algorithm.save()

  one = trained()
  pretend_two_processes(monkeypatch)
  monkeypatch.setattr(distributed, "is_initialized", lambda: True)
  two = trained()
  assert one["algorithm_state_dict"]["rounds_done"] > 5
  assert_learned_the_same(one, two)


def test_actions_are_bounded_by_the_reach_of_their_joints() -> None:
  terms = {"gripper": object(), "legs": SimpleNamespace(reach=torch.tensor([[2.0, math.inf]]))}
  slices = {"gripper": slice(0, 1), "legs": slice(1, 3)}
  manager = SimpleNamespace(total_action_dim=3, term_slices=lambda: slices, get_term=terms.__getitem__)
  env = SimpleNamespace(action_manager=manager)
  assert action_bounds(env, 3, SacCfg(action_bound=0.5)).tolist() == [[0.5, 2.0, 0.5]]
  assert action_bounds(env, 3, SacCfg(action_bound=0.5, joint_limits=False)).tolist() == [[0.5, 0.5, 0.5]]


def test_a_custom_algorithm_is_one_class_in_one_file(tmp_path: Path) -> None:
  def run(iterations: int, folder: str, resume: Path | None = None) -> Any:
    agent = agent_of("fastsac", class_name="rl_third_learner:Weighted")
    agent.max_iterations = iterations
    task = TaskCfg(env=PointEnvCfg(), agent=agent)
    console = Console("quiet")
    return train(task, name="Point", make_env=PointEnv, log_root=tmp_path / folder, resume=resume, console=console)

  whole, half = run(4, "whole"), run(2, "half")
  resumed = run(4, "resumed", half.checkpoint)
  ours, theirs = (torch.load(path.checkpoint, weights_only=True)["actor_state_dict"] for path in (whole, resumed))
  assert all(torch.equal(ours[name], theirs[name]) for name in ours)
  assert "Loss/loss" in (whole.directory / "progress.csv").read_text().splitlines()[0]


mjlab_rl.trust_package("rl_third_learner")
