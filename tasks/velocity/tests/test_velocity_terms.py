"""Every term of the flat Go1 task against NumPy and MuJoCo C, on states that random actions lead to."""

import numpy as np
import pytest
import torch
from velocity_rollout import Rollout, Step

AMPLITUDE = {"base_lin_vel": 0.5, "base_ang_vel": 0.2, "projected_gravity": 0.05, "joint_pos": 0.01, "joint_vel": 1.5}
PUSH = np.array([0.5, 0.5, 0.4, 0.52, 0.52, 0.78])


def roll(rollout: Rollout, steps: int, timed_out_at: int) -> list[list[Step]]:
  """Random actions, held for four steps, from timid to wild by world; one world in four runs out of time."""
  n = rollout.env.num_envs
  generator = torch.Generator().manual_seed(3)
  scale = torch.tensor([0.2, 0.5, 1.5, 0.4]).repeat(n // 4)[:, None]
  action = torch.zeros(n, 12)
  seen = []
  for step in range(steps):
    if step % 4 == 0:
      action = torch.randn(n, 12, generator=generator) * scale
    if step == timed_out_at - 5:
      for world in range(0, n, 4):
        rollout.set_age(world, 995)
    seen.append(rollout.step(action))
  return seen


@pytest.fixture(scope="module")
def rollout() -> Rollout:
  return Rollout(16)


@pytest.fixture(scope="module")
def history(rollout: Rollout) -> list[list[Step]]:
  return roll(rollout, 240, timed_out_at=45)


@pytest.fixture(scope="module")
def steps(history: list[list[Step]]) -> list[Step]:
  return [step for steps in history for step in steps]


def check_rewards(steps: list[Step], tol: float) -> None:
  for name in steps[0].rewards:
    ours, oracle = np.array([step.rewards[name] for step in steps]).T
    np.testing.assert_allclose(ours, oracle, rtol=tol, atol=tol, err_msg=name)
  ours, oracle = np.array([step.total for step in steps]).T
  np.testing.assert_allclose(ours, oracle, rtol=tol, atol=tol, err_msg="total")


def check_critic(steps: list[Step], tol: float) -> None:
  for name in steps[0].critic:
    ours, oracle = (np.array([step.critic[name][i] for step in steps]) for i in range(2))
    np.testing.assert_allclose(ours, oracle, rtol=tol, atol=tol, err_msg=name)


def test_every_reward_is_its_formula(steps: list[Step]) -> None:
  check_rewards(steps, 2e-6)


def test_the_rollout_shows_every_reward_at_work(steps: list[Step]) -> None:
  for name in steps[0].rewards:
    values = [step.rewards[name][1] for step in steps]
    assert sum(value != 0.0 for value in values) > 20, name
    assert max(values) > 2.0 * min(values), name
  # Commands on either side of every gate, so that each reward is seen open and closed.
  speed = [float(np.hypot(*step.command[:2]) + abs(step.command[2])) for step in steps]
  for lo, hi in ((0.0, 0.05), (0.05, 0.5), (0.5, 9.0)):
    assert sum(lo <= s < hi for s in speed) > 50


def test_the_critic_sees_every_quantity_without_noise(steps: list[Step]) -> None:
  check_critic(steps, 2e-6)


@pytest.mark.parametrize("name", AMPLITUDE)
def test_the_actor_sees_uniform_noise_of_the_right_size(steps: list[Step], name: str) -> None:
  noise = np.array([step.actor[name][0] - step.actor[name][1] for step in steps]) / AMPLITUDE[name]
  limit = 1.0 + 1e-5 / AMPLITUDE[name]
  assert np.abs(noise).max() < limit
  assert np.abs(noise).max() > 0.99
  spread = 1.0 / np.sqrt(3.0)
  assert abs(noise.mean()) < 5.0 * spread / np.sqrt(noise.size)
  assert abs(noise.std() - spread) < 0.01
  # No two components share their draws.
  mixed = np.corrcoef(noise.T) - np.eye(noise.shape[1])
  assert np.abs(mixed).max() < 5.0 / np.sqrt(len(noise))


def test_the_actor_sees_actions_and_command_as_they_are(steps: list[Step]) -> None:
  for name in ("actions", "command"):
    assert all(np.array_equal(step.actor[name][0], step.critic[name][0]) for step in steps)


def test_physics_is_that_of_mujoco_c_under_set_points_less_the_encoder_bias(steps: list[Step]) -> None:
  for i, tol in ((0, 1e-8), (1, 1e-6)):
    ours, oracle = (np.array([step_part[i] for step_part in part]) for part in _physics(steps))
    np.testing.assert_allclose(ours, oracle, rtol=0.0, atol=tol)


def test_contacts_and_their_forces_are_those_of_mujoco_c_in_every_substep(steps: list[Step]) -> None:
  found = np.array([step.found for step in steps])
  force = np.array([step.force for step in steps])
  assert np.array_equal(found[:, :, 0], found[:, :, 1])
  np.testing.assert_allclose(force[:, :, 0], force[:, :, 1], rtol=0.0, atol=1e-4)
  assert 0.1 < found.mean() < 0.9


def test_episodes_end_by_a_tilt_of_seventy_degrees_or_after_a_thousand_steps(steps: list[Step]) -> None:
  assert [step.fell[0] for step in steps] == [step.fell[1] for step in steps]
  assert [step.timed_out[0] for step in steps] == [step.timed_out[1] for step in steps]
  assert sum(step.fell[0] for step in steps) >= 3
  assert sum(step.timed_out[0] for step in steps) >= 3


def test_a_reset_puts_the_robot_at_rest_in_its_default_pose_near_its_origin(
  rollout: Rollout, steps: list[Step]
) -> None:
  ended = [step for step in steps if step.fell[0] or step.timed_out[0]]
  origins = rollout.env.scene.env_origins.numpy()
  for step in ended:
    qpos, qvel = step.after
    offset = qpos[:3] - origins[step.world]
    assert np.abs(offset[:2]).max() <= 0.5
    assert 0.278 + 0.0265 - 1e-9 <= offset[2] <= 0.278 + 0.0665 + 1e-9
    assert np.allclose(qpos[[4, 5]], 0.0)
    np.testing.assert_allclose(qpos[7:], [0.1, 0.9, -1.8, -0.1, 0.9, -1.8, 0.1, 0.9, -1.8, -0.1, 0.9, -1.8], atol=1e-12)
    assert not qvel.any()


def test_nothing_but_a_push_moves_a_robot_whose_episode_goes_on(history: list[list[Step]]) -> None:
  pushes: list[np.ndarray] = []
  since = dict.fromkeys(range(len(history[0])), 0)
  waits = []
  for steps in history:
    for step in steps:
      since[step.world] += 1
      if step.fell[0] or step.timed_out[0]:
        since[step.world] = 0
        continue
      assert np.array_equal(step.before[0], step.after[0])
      change = step.after[1] - step.before[1]
      assert not change[6:].any()
      if not change.any():
        continue
      pushes.append(np.concatenate([change[:3], _rotation(step.after[0][3:7]) @ change[3:6]]))
      waits.append(since[step.world] * 0.02)
      since[step.world] = 0
  assert len(pushes) > 10
  assert (np.abs(pushes).max(0) <= PUSH + 1e-9).all()
  assert (np.abs(pushes).max(0) > 0.7 * PUSH).all()
  # Timers of 1 to 3 s run from the step after the reset and are served in whole steps.
  assert min(waits) >= 1.0 - 1e-6
  assert max(waits) <= 3.0 + 0.02 + 1e-6


@pytest.mark.warp
def test_every_term_is_its_formula_on_mujoco_warp() -> None:
  rollout = Rollout(4, engine="warp")
  steps = [step for steps in roll(rollout, 40, timed_out_at=20) for step in steps]
  check_rewards(steps, 1e-5)
  check_critic(steps, 2e-5)
  # Single precision may see a contact begin or end a substep apart, now and then.
  for i, tol in ((0, 2e-5), (1, 2e-3)):
    ours, oracle = (np.array([step_part[i] for step_part in part]) for part in _physics(steps))
    assert np.quantile(np.abs(ours - oracle).max(1), 0.98) < tol
  found = np.array([step.found for step in steps])
  force = np.array([step.force for step in steps])
  for world in rollout.worlds:
    for field in ("body_invweight0", "dof_invweight0", "actuator_acc0"):
      ours = getattr(rollout.env.sim.model, field)[world.index].double().numpy()
      np.testing.assert_allclose(ours, getattr(world.model, field), rtol=2e-4, atol=1e-6, err_msg=field)
  assert (found[:, :, 0] != found[:, :, 1]).mean() < 0.005
  assert np.median(np.abs(force[:, :, 0] - force[:, :, 1]).max((1, 2))) < 0.1
  for name, amplitude in AMPLITUDE.items():
    noise = np.array([step.actor[name][0] - step.actor[name][1] for step in steps])
    assert np.abs(noise).max() < amplitude + 1e-4
  assert all(step.fell[0] == step.fell[1] and step.timed_out[0] == step.timed_out[1] for step in steps)


def _physics(steps: list[Step]) -> tuple[list[tuple[np.ndarray, np.ndarray]], list[tuple[np.ndarray, np.ndarray]]]:
  return [step.before for step in steps], [step.shadow for step in steps]


def _rotation(quat: np.ndarray) -> np.ndarray:
  w, x, y, z = quat
  return np.array(
    [
      [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
      [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
      [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
  )
