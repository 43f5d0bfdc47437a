"""Off-policy learning: returns, noise, layers, learning, and an exact resume."""

import copy
import dataclasses
from pathlib import Path
from typing import Any

import mjlab_rl
import numpy as np
import pytest
import torch
from mjlab_core.errors import ConfigError, FileError, UnknownNameError
from mjlab_rl import CheckpointPolicy, OffPolicyRunnerCfg, RslRlOnPolicyRunnerCfg, TaskCfg, train, with_agent
from mjlab_rl.offpolicy import PRESETS
from mjlab_rl.offpolicy.networks import Normalizer, TanhGaussian
from mjlab_rl.offpolicy.replay import Reflection, Transitions
from mjlab_rl.offpolicy.returns import RepeatedNoise, ReturnScale, project
from mjlab_rl.offpolicy.runner import REPLAY_NAME, MjlabOffPolicyRunner
from mjlab_rl.vec_env import RslRlVecEnvWrapper
from rl_learners import QUIET, assert_same_checkpoints
from rl_point_env import PointEnv, PointEnvCfg, PointSceneCfg


def slow_projection(probabilities: np.ndarray, values: np.ndarray, support: np.ndarray) -> np.ndarray:
  """Each value's probability, shared by distance between the atoms around it."""
  result, step = np.zeros_like(probabilities), support[1] - support[0]
  for row in np.ndindex(*probabilities.shape[:-1]):
    for p, value in zip(probabilities[row], np.clip(values[row], support[0], support[-1]), strict=True):
      result[row] += p * np.clip(1.0 - np.abs(support - value) / step, 0.0, 1.0)
  return result


def test_the_projection_of_a_distribution_is_that_of_a_slow_reference() -> None:
  torch.manual_seed(0)
  support = torch.linspace(-2.0, 2.0, 9)
  probabilities = torch.rand(2, 40, 9).softmax(-1)
  # Values between atoms, on atoms, at both ends and outside.
  values = torch.randn(2, 40, 9) * 2.0
  values[0, :10] = support
  values[1, :10] = support[torch.randint(9, (10, 9))]
  values[1, 10:20] = 2.0
  projected = project(probabilities, values, support)
  expected = slow_projection(probabilities.double().numpy(), values.double().numpy(), support.double().numpy())
  np.testing.assert_allclose(projected.numpy(), expected, atol=1e-5)
  torch.testing.assert_close(projected.sum(-1), torch.ones(2, 40))
  torch.testing.assert_close(projected[0, :10], probabilities[0, :10])


def test_noise_stays_for_the_lengths_of_a_zeta_distribution() -> None:
  torch.manual_seed(0)
  noise = RepeatedNoise(2000, 1, 4, "cpu")
  history = torch.stack([noise.next()[:, 0].clone() for _ in range(60)])
  lengths = []
  for world in history.T.numpy():
    changes = np.flatnonzero(np.diff(world)) + 1
    lengths += np.diff(changes).tolist()
  share = np.bincount(lengths, minlength=5)[1:5] / len(lengths)
  expected = 1.0 / np.arange(1, 5) ** 2
  np.testing.assert_allclose(share, expected / expected.sum(), atol=0.01)
  assert abs(history.std() - 1.0) < 0.02
  once = RepeatedNoise(50, 2, 1, "cpu")
  before = once.next().clone()
  assert (once.next() != before).all()


def test_the_normaliser_learns_the_moments_of_all_batches_in_place() -> None:
  torch.manual_seed(0)
  normalizer = Normalizer(3)
  addresses = [value.data_ptr() for value in normalizer.state_dict().values()]
  batches = [torch.randn(7, 3) * scale + 5.0 for scale in (1.0, 4.0, 0.1)]
  for batch in batches:
    normalizer.update(batch)
  everything = torch.cat(batches)
  torch.testing.assert_close(normalizer.mean, everything.mean(0))
  torch.testing.assert_close(normalizer.std, everything.std(0, unbiased=False))
  assert [value.data_ptr() for value in normalizer.state_dict().values()] == addresses


def test_the_density_of_a_bounded_action_is_that_of_its_change_of_variables() -> None:
  torch.manual_seed(0)
  squash = TanhGaussian(2, (-3.0, 1.0))
  squash.bound.copy_(torch.tensor([[0.5, 8.0]]))
  output = torch.randn(200, 2, 2)
  action, log_prob = squash.sample_with_log_prob(output)
  assert (action.abs() <= squash.bound).all()
  mean, std = squash.split(output)
  inside = (action.abs() < 0.999 * squash.bound).all(-1)
  unbounded = torch.atanh((action / squash.bound).double())
  normal = torch.distributions.Normal(mean.double(), std.double())
  slope = squash.bound * (1.0 - (action / squash.bound).double().square())
  expected = (normal.log_prob(unbounded) - slope.log()).sum(-1)
  torch.testing.assert_close(log_prob[inside].double(), expected[inside], atol=1e-3, rtol=1e-3)
  # The density of one action integrates to one.
  grid = torch.linspace(-0.4999, 0.4999, 20_001).double()
  normal = torch.distributions.Normal(mean[0, 0].double(), std[0, 0].double())
  density = normal.log_prob(torch.atanh(grid / 0.5)).exp() / (0.5 * (1.0 - (grid / 0.5).square()))
  assert float(torch.trapezoid(density, grid)) == pytest.approx(1.0, abs=0.01)


def test_scaled_returns_fill_the_values_of_the_critic() -> None:
  torch.manual_seed(0)
  scale = ReturnScale(64, 0.9, 5.0)
  for _ in range(300):
    scale.add(1.0 + 0.1 * torch.randn(64), torch.zeros(64))
  # The largest discounted return is about 10; divided it is the end of the values.
  assert float(scale.largest / scale.divisor()) <= 5.0 + 1e-4
  assert 1.5 < float(scale.divisor()) < 3.0
  scale.add(torch.ones(64), torch.ones(64))
  assert not scale.running.any()


def test_a_reflection_appends_mirror_images() -> None:
  mirrors = {"a": ((1, 0), (1.0, -1.0)), "b": ((0,), (-1.0,)), "action": ((1, 0), (-1.0, -1.0))}
  seen = torch.tensor([[1.0, 2.0, 3.0]])
  one = Transitions(seen, torch.tensor([[4.0, 5.0]]), torch.tensor([6.0]), torch.tensor([7.0]), 2.0 * seen)
  both = Reflection(mirrors, ("a", "b"), "cpu")(one)
  assert both.obs.tolist() == [[1.0, 2.0, 3.0], [2.0, -1.0, -3.0]]
  assert torch.equal(both.next_obs, 2.0 * both.obs)
  assert both.action.tolist() == [[4.0, 5.0], [-5.0, -4.0]]
  assert (both.reward.tolist(), both.discount.tolist()) == ([6.0, 6.0], [7.0, 7.0])


def agent_of(preset: str, **algorithm: Any) -> OffPolicyRunnerCfg:
  agent = PRESETS[preset](RslRlOnPolicyRunnerCfg(experiment_name="point", logger="none"))
  agent.num_steps_per_env, agent.max_iterations, agent.save_interval, agent.save_replay = 12, 4, 2, True
  agent.actor.hidden_dims = agent.critic.hidden_dims = (16, 16)
  values = {"batch_size": 32, "updates_per_step": 1.0, "policy_every": 2, "learning_starts": 5, "replay_steps": 40}
  agent.algorithm = dataclasses.replace(agent.algorithm, **(values | algorithm))
  return agent


def runner_of(agent: OffPolicyRunnerCfg, num_envs: int = 4, **cfg: Any) -> MjlabOffPolicyRunner:
  env_cfg = PointEnvCfg(scene=PointSceneCfg(num_envs=num_envs), **cfg)
  agent.prepare_env(env_cfg)
  return MjlabOffPolicyRunner(RslRlVecEnvWrapper(PointEnv(env_cfg)), agent, None, "cpu", console=QUIET)


def test_time_outs_bootstrap_from_the_last_observation_and_terminations_do_not() -> None:
  torch.manual_seed(0)
  runner = runner_of(agent_of("fastsac", n_step=1, replay_steps=200), num_envs=8, noise=0.4)
  obs = runner.env.get_observations()
  for _ in range(60):
    obs, *_ = runner.algorithm.collect(runner.env, obs)
  batch = runner.algorithm.replay.sample(2000, 1, 0.9)
  # Position and velocity are columns 0 and 1, the age is the last; each step moves the position by 0.1 of the velocity.
  moved = batch.next_obs[:, 0] - batch.obs[:, 0]
  age = batch.next_obs[:, 4] * 12.0
  bootstraps = batch.discount > 0
  torch.testing.assert_close(moved[bootstraps], 0.1 * batch.next_obs[bootstraps, 1], atol=1e-5, rtol=0.0)
  assert int((bootstraps & (age.round() == 12)).sum()) > 10
  assert int((~bootstraps).sum()) > 10
  assert (batch.obs[bootstraps, 0].abs() <= 1.0).all()


def test_the_target_uses_the_present_normaliser_and_follows_the_critic() -> None:
  runner = runner_of(agent_of("fastsac", tau=0.5))
  algorithm: Any = runner.algorithm
  obs = runner.env.get_observations()
  for _ in range(8):
    obs, *_ = algorithm.collect(runner.env, obs)
  assert algorithm.target.obs_normalizer is algorithm.critic.obs_normalizer
  assert int(algorithm.critic.obs_normalizer.count) == 8 * 4
  old = [p.clone() for p in algorithm.target.parameters()]
  others = [p.clone() for p in algorithm.actor.parameters()]
  algorithm._update_critic(algorithm.sample())
  for before, after, online in zip(old, algorithm.target.parameters(), algorithm.critic.parameters(), strict=True):
    torch.testing.assert_close(after, 0.5 * before + 0.5 * online)
  assert all(torch.equal(a, b) for a, b in zip(others, algorithm.actor.parameters(), strict=True))
  critic = [p.clone() for p in algorithm.critic.parameters()]
  algorithm._update_policy(algorithm.sample())
  assert all(torch.equal(a, b) for a, b in zip(critic, algorithm.critic.parameters(), strict=True))
  assert any(not torch.equal(a, b) for a, b in zip(others, algorithm.actor.parameters(), strict=True))


@pytest.mark.parametrize(("ratio", "rounds"), [(2.0, 15), (0.5, 3)])
def test_updates_are_interleaved_by_their_ratio(ratio: float, rounds: int) -> None:
  runner = runner_of(agent_of("fastsac", updates_per_step=ratio, policy_every=2, learning_starts=5))
  obs = runner.env.get_observations()
  for _ in range(20):
    obs, *_ = runner.algorithm.collect(runner.env, obs)
    runner.algorithm.update()
  # 15 steps follow the fifth, each with ratio / 2 rounds.
  assert runner.algorithm.rounds_done == rounds


each_preset = pytest.mark.parametrize("preset", ["fastsac", "flashsac"])


@each_preset
def test_two_iterations_and_two_more_equal_four(tmp_path: Path, preset: str) -> None:
  def run(iterations: int, folder: str, resume: Path | None = None) -> Any:
    agent = agent_of(preset)
    agent.max_iterations, agent.algorithm.final_learning_rate = iterations, None
    task = TaskCfg(env=PointEnvCfg(), agent=agent)
    return train(task, name="Point", make_env=PointEnv, log_root=tmp_path / folder, resume=resume, console=QUIET)

  whole, half = run(4, "whole"), run(2, "half")
  resumed = run(4, "resumed", half.checkpoint)
  for name in (whole.checkpoint.name, REPLAY_NAME):
    assert_same_checkpoints(whole.directory / name, resumed.directory / name)
  # Without its memory the run continues, and updates begin again when a new one is ready.
  (half.directory / REPLAY_NAME).unlink()
  assert run(4, "without", half.checkpoint).iterations == 4
  policy = CheckpointPolicy(PointEnv(PointEnvCfg()), agent_of(preset))
  policy.load(whole.checkpoint)
  assert (policy({"actor": torch.zeros(4, 2), "critic": torch.zeros(4, 3)}).abs() <= 1.0).all()


@each_preset
def test_the_exported_network_acts_as_the_policy(preset: str) -> None:
  runner = runner_of(agent_of(preset))
  runner.learn(2)
  actor: Any = runner.networks["actor"].eval()
  exported = actor.as_onnx(verbose=False).eval()
  obs = torch.randn(1, 2)
  torch.testing.assert_close(exported(obs), actor.squash.deterministic_output(actor.output(obs)))


@each_preset
def test_a_point_is_pushed_to_the_middle(preset: str) -> None:
  torch.manual_seed(1)
  agent = agent_of(preset, batch_size=128, updates_per_step=2.0, gamma=0.9, tau=0.1, learning_rate=4e-3, n_step=1)
  agent.algorithm.final_learning_rate, agent.algorithm.value_limit, agent.algorithm.return_scaling = None, 5.0, True
  agent.algorithm.replay_steps, agent.algorithm.action_bound = 400, 3.0
  runner = runner_of(agent, num_envs=32, noise=0.0, episode_steps=24)

  def mean_reward(effort: float) -> float:
    env = PointEnv(PointEnvCfg(scene=PointSceneCfg(num_envs=200), noise=0.0, episode_steps=24, seed=9))
    env.reset()
    actor: Any = runner.networks["actor"].eval()
    total = torch.zeros(())
    for _ in range(24):
      with torch.no_grad():
        action = actor.squash.deterministic_output(actor.output(env.get_observations()["actor"]))
      total += env.step(effort * action)[1].mean() / 24
    return float(total)

  runner.learn(18)
  # At rest in the middle the mean is 1.
  assert mean_reward(0.0) < 0.75
  assert mean_reward(1.0) > 0.88


def test_mistakes_in_the_configuration_are_refused(tmp_path: Path) -> None:
  task: Any = TaskCfg(env=PointEnvCfg(), agent=RslRlOnPolicyRunnerCfg(logger="none", max_iterations=1))
  assert with_agent(task, "ppo") is task
  assert isinstance(with_agent(task, "flashsac").agent, OffPolicyRunnerCfg)
  with pytest.raises(UnknownNameError, match=r"learner 'flashsax'.*flashsac"):
    with_agent(task, "flashsax")
  agent = agent_of("flashsac")
  agent.clip_actions, agent.critic.hidden_dims, agent.algorithm.replay_steps = 1.0, (8, 9), 8
  agent.algorithm.n_step = 7
  with pytest.raises(ConfigError) as caught:
    agent.to_rsl_rl()
  for word in ("clip_actions must be None", "same width", "n_step + 3 = 10"):
    assert word in str(caught.value)
  unprepared = MjlabOffPolicyRunner(RslRlVecEnvWrapper(PointEnv(PointEnvCfg())), agent_of("fastsac"), console=QUIET)
  with pytest.raises(ConfigError, match="final_obs"):
    unprepared.learn(1)
  ppo = train(task, name="Point", make_env=PointEnv, log_root=tmp_path, console=QUIET)
  assert ppo.checkpoint is not None
  other = copy.deepcopy(task)
  other.agent = agent_of("fastsac")
  with pytest.raises(FileError, match=r"not of an off-policy run; --init-from"):
    train(other, name="Point", make_env=PointEnv, log_root=tmp_path, resume=ppo.checkpoint, console=QUIET)


def test_half_precision_and_mirrors_take_part_in_updates() -> None:
  agent = agent_of("fastsac", replay_half=True, symmetry=point_mirror)
  runner = runner_of(agent)
  runner.learn(2)
  batch = runner.algorithm.sample()
  assert batch.obs.shape == (64, 5)
  torch.testing.assert_close(batch.obs[32:, :2], -batch.obs[:32, :2])
  torch.testing.assert_close(batch.action[32:], -batch.action[:32])
  assert runner.algorithm.replay.num_bytes == 40 * 4 * ((5 + 1) * 2 + 5)


def point_mirror(env: Any) -> dict[str, Any]:
  del env
  return {"actor": ((0, 1), (-1.0, -1.0)), "critic": ((0, 1, 2), (-1.0, -1.0, 1.0)), "action": ((0,), (-1.0,))}


mjlab_rl.trust_package("rl_point_env")
