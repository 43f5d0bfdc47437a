"""Both cartpole tasks against NumPy and MuJoCo C."""

import math
from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_cartpole import balance, swingup
from mjlab_cartpole.terms import gaussian, quadratic
from mjlab_envs import ManagerBasedRlEnv

TASKS = {"Mjlab-Cartpole-Balance": balance, "Mjlab-Cartpole-Swingup": swingup}
Make = Callable[[], Any]
both = pytest.mark.parametrize("make", TASKS.values(), ids=["balance", "swingup"])


def make_env(make: Make, num_envs: int, engine: str = "auto") -> ManagerBasedRlEnv:
  cfg = make().env
  cfg.scene.num_envs, cfg.seed, cfg.sim.engine = num_envs, 5, engine
  return ManagerBasedRlEnv(cfg, device="cpu")


def state(env: ManagerBasedRlEnv) -> tuple[np.ndarray, ...]:
  """Slider, hinge and their velocities in each world."""
  return (*env.sim.data.qpos.double().numpy().T.copy(), *env.sim.data.qvel.double().numpy().T.copy())


def reward(x: np.ndarray, angle: np.ndarray, spin: np.ndarray, action: np.ndarray) -> np.ndarray:
  """The product of four factors, from its formula."""

  def kernel(value: np.ndarray, margin: float) -> np.ndarray:
    return np.exp(-0.5 * (value * math.sqrt(-2.0 * math.log(0.1)) / margin) ** 2)

  small = np.maximum(0.0, 1.0 - 0.9 * action**2)
  return (np.cos(angle) + 1) / 2 * (1 + kernel(x, 2.0)) / 2 * (4 + small) / 5 * (1 + kernel(spin, 5.0)) / 2


@pytest.mark.parametrize("name", TASKS)
def test_the_tasks_are_found_under_their_names(name: str) -> None:
  (entry,) = entry_points(group="mjlab.tasks", name=name)
  assert entry.load()().env == TASKS[name]().env


@both
def test_the_reward_is_its_formula_in_every_state(make: Make) -> None:
  env = make_env(make, 64)
  env.reset()
  generator = torch.Generator().manual_seed(1)
  seen = []
  for _ in range(60):
    action = torch.randn(64, 1, generator=generator) * 1.5
    _, ours, _, _, _ = env.step(action)
    x, angle, _, spin = state(env)
    expected = reward(x, angle, spin, action[:, 0].double().numpy())
    # Weight 1, times the 50 ms of a step.
    np.testing.assert_allclose(ours.numpy(), 0.05 * expected, rtol=1e-5, atol=1e-8)
    seen.append(expected)
  assert np.min(seen) < 0.1
  if make is balance:
    assert np.max(seen) > 0.9


def test_the_kernels_are_a_tenth_at_their_margins() -> None:
  margin = torch.tensor([0.0, 2.0, -2.0])
  for kernel in (gaussian, quadratic):
    torch.testing.assert_close(kernel(margin, 2.0), torch.tensor([1.0, 0.1, 0.1]))
  assert quadratic(torch.tensor(3.0), 2.0) == 0.0
  values = [reward(*(np.array(v) for v in point)) for point in ((2.0, 0.0, 0.0, 0.0), (0.0, 0.0, 5.0, 0.0))]
  assert values == pytest.approx([0.55, 0.55])
  assert reward(*(np.array(v) for v in (0.0, 0.0, 0.0, 1.0))) == pytest.approx(4.1 / 5)
  assert reward(*(np.array(v) for v in (0.0, 0.0, 0.0, 5.0))) == pytest.approx(4.0 / 5)


@both
def test_both_networks_see_position_angle_and_velocities_without_noise(make: Make) -> None:
  env = make_env(make, 8)
  observations, _ = env.reset()
  for _ in range(20):
    x, angle, v, spin = state(env)
    expected = np.stack([x, np.cos(angle), np.sin(angle), v, spin], 1)
    for group in ("actor", "critic"):
      seen: Any = observations[group]
      assert seen.dtype == torch.float32
      np.testing.assert_allclose(seen.numpy(), expected, rtol=1e-6, atol=1e-6)
    observations = env.step(torch.randn(8, 1))[0]


@both
def test_episodes_begin_within_their_ranges(make: Make) -> None:
  env = make_env(make, 100)
  starts = []
  for _ in range(5):
    env.reset()
    starts.append(np.stack(state(env)))
  x, angle, v, spin = np.concatenate(starts, 1)
  middle = 0.0 if make is balance else math.pi
  limits = {"angle": (angle - middle, 0.034), "v": (v, 0.01), "spin": (spin, 0.01)}
  if make is balance:
    limits["x"] = (x, 0.1)
  else:
    assert not x.any()
  for name, (values, limit) in limits.items():
    assert np.abs(values).max() <= limit + 1e-12, name
    assert np.abs(values).max() > 0.98 * limit, name
    assert abs(values.mean()) < 5.0 * limit / math.sqrt(3.0 * 500), name
    assert len(np.unique(values)) > 490, name
  assert np.abs(np.corrcoef([angle, v, spin]) - np.eye(3)).max() < 0.2


@both
def test_an_action_is_a_force_that_saturates_at_ten_newton(make: Make) -> None:
  env = make_env(make, 5)
  env.reset()
  action = torch.tensor([[-3.0], [-1.0], [0.25], [1.0], [3.0]])
  start = env.sim.data.qpos.numpy().copy(), env.sim.data.qvel.numpy().copy()
  env.step(action)
  data = mujoco.MjData(env.sim.mj_model)
  for world in range(5):
    mujoco.mj_resetData(env.sim.mj_model, data)
    data.qpos[:], data.qvel[:] = start[0][world], start[1][world]
    data.ctrl[:] = action[world].clamp(-1.0, 1.0).numpy()
    mujoco.mj_step(env.sim.mj_model, data, 5)
    np.testing.assert_allclose(env.sim.data.qpos[world].numpy(), data.qpos, atol=1e-9)
    np.testing.assert_allclose(env.sim.data.qvel[world].numpy(), data.qvel, atol=1e-8)
    assert env.sim.data.actuator_force[world].item() == pytest.approx(np.clip(action[world].item(), -1.0, 1.0))


@both
def test_only_time_ends_an_episode(make: Make) -> None:
  env = make_env(make, 2)
  env.reset()
  assert (env.physics_dt, env.step_dt, env.max_episode_length) == (0.01, 0.05, 1000)
  env.sim.data.qpos[0, 1] = 2.0
  env.episode_length_buf[:] = torch.tensor([10, 998])
  ends = [[flag.tolist() for flag in env.step(torch.zeros(2, 1))[2:4]] for _ in range(3)]
  no, second = [False, False], [False, True]
  assert ends == [[no, no], [no, second], [no, no]]
  assert env.episode_length_buf.tolist() == [13, 1]


@both
def test_play_only_makes_episodes_endless(make: Make) -> None:
  task = make()
  cfg = task.play(task.env)
  assert cfg.episode_length_s == 1e10
  cfg.episode_length_s = 50.0
  assert cfg == make().env


@both
def test_the_learner_is_that_of_the_table(make: Make) -> None:
  agent = make().agent
  for model in (agent.actor, agent.critic):
    assert (model.hidden_dims, model.activation, model.obs_normalization) == ((64, 64), "elu", False)
  assert agent.actor.distribution_cfg["init_std"] == 1.0
  algorithm = agent.algorithm
  assert (algorithm.entropy_coef, algorithm.learning_rate, algorithm.schedule) == (0.01, 1e-3, "adaptive")
  assert (algorithm.num_learning_epochs, algorithm.num_mini_batches, algorithm.clip_param) == (5, 4, 0.2)
  assert (algorithm.gamma, algorithm.lam, algorithm.desired_kl, algorithm.max_grad_norm) == (0.99, 0.95, 0.01, 1.0)
  assert (agent.num_steps_per_env, agent.max_iterations, agent.save_interval) == (32, 500, 50)
  assert agent.experiment_name == "cartpole"


@pytest.mark.warp
def test_both_engines_swing_up_alike() -> None:
  native, warp = make_env(swingup, 3, "native"), make_env(swingup, 3, "warp")
  native.reset()
  warp.reset()
  # The engines draw in different precisions, so one takes the start of the other.
  for name in ("qpos", "qvel"):
    getattr(warp.sim.data, name).copy_(getattr(native.sim.data, name))
  generator = torch.Generator().manual_seed(2)
  for _ in range(20):
    action = torch.randn(3, 1, generator=generator)
    one, other = native.step(action), warp.step(action)
    torch.testing.assert_close(other[0]["actor"], one[0]["actor"], rtol=0.0, atol=2e-3)
    torch.testing.assert_close(other[1], one[1], rtol=0.0, atol=1e-4)
