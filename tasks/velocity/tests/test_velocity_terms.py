"""Every term of all four tasks against NumPy and MuJoCo C, on states that random actions lead to."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from mjlab_managers import MetricsTermCfg
from mjlab_velocity import go1_flat
from velocity_facts import TASKS
from velocity_oracle import Contacts, matrix
from velocity_rollout import STATE, Rollout, Step, note_state, started_env

AMPLITUDE = {
  "base_lin_vel": 0.5,
  "base_ang_vel": 0.2,
  "projected_gravity": 0.05,
  "joint_pos": 0.01,
  "joint_vel": 1.5,
  "height_scan": 0.1 / 5.0,
}
PUSH = np.array([0.5, 0.5, 0.4, 0.52, 0.52, 0.78])
# With these, some worlds stand and others walk.
SEED = {
  "Mjlab-Velocity-Flat-Unitree-Go1": 7,
  "Mjlab-Velocity-Flat-Unitree-G1": 15,
  "Mjlab-Velocity-Rough-Unitree-Go1": 5,
  "Mjlab-Velocity-Rough-Unitree-G1": 14,
}


@dataclass
class Played:
  """A rollout and its steps, each of all worlds."""

  rollout: Rollout
  history: list[list[Step]]

  @property
  def steps(self) -> list[Step]:
    return [step for steps in self.history for step in steps]


def roll(rollout: Rollout, steps: int, timed_out_at: int) -> list[list[Step]]:
  """Random actions, held for four steps, from timid to wild by world; one world in four runs out of time."""
  n = rollout.env.num_envs
  generator = torch.Generator().manual_seed(3)
  scale = torch.tensor([0.2, 0.5, 1.5, 0.4]).repeat(n // 4)[:, None]
  action = torch.zeros(n, rollout.num_actions)
  seen = []
  for step in range(steps):
    if step % 4 == 0:
      action = torch.randn(n, rollout.num_actions, generator=generator) * scale
    if step == timed_out_at - 5:
      for world in range(0, n, 4):
        rollout.set_age(world, 995)
    seen.append(rollout.step(action))
  return seen


@pytest.fixture(scope="module", params=TASKS)
def played(request: pytest.FixtureRequest) -> Played:
  rollout = Rollout(request.param, 16, seed=SEED[request.param])
  return Played(rollout, roll(rollout, 40 if rollout.task.rough else 50, timed_out_at=25))


@pytest.fixture
def steps(played: Played) -> list[Step]:
  return played.steps


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
    assert sum(value != 0.0 for value in values) > 3, name
    assert max(values) > 2.0 * min(values), name
  # Commands on either side of every gate, so that each reward is seen open and closed.
  speed = [float(np.hypot(*step.command[:2]) + abs(step.command[2])) for step in steps]
  for lo, hi in ((0.0, 0.05), (0.05, 0.5), (0.5, 9.0)):
    assert sum(lo <= s < hi for s in speed) > 20


def test_the_critic_sees_every_quantity_without_noise(steps: list[Step]) -> None:
  check_critic(steps, 2e-6)


def test_the_actor_sees_uniform_noise_of_the_right_size(steps: list[Step]) -> None:
  for name in (name for name in AMPLITUDE if name in steps[0].actor):
    noise = np.array([step.actor[name][0] - step.actor[name][1] for step in steps]) / AMPLITUDE[name]
    limit = 1.0 + 1e-5 / AMPLITUDE[name]
    assert np.abs(noise).max() < limit, name
    assert np.abs(noise).max() > 0.99, name
    spread = 1.0 / np.sqrt(3.0)
    assert abs(noise.mean()) < 5.0 * spread / np.sqrt(noise.size), name
    assert abs(noise.std() - spread) < 2.5 * spread / np.sqrt(noise.size), name
    # No two components share their draws.
    mixed = np.corrcoef(noise.T) - np.eye(noise.shape[1])
    assert np.abs(mixed).max() < 5.5 / np.sqrt(len(noise)), name


def test_the_actor_sees_actions_and_command_as_they_are(steps: list[Step]) -> None:
  for name in ("actions", "command"):
    assert all(np.array_equal(step.actor[name][0], step.critic[name][0]) for step in steps)


def test_physics_is_that_of_mujoco_c_under_targets_less_the_encoder_bias(steps: list[Step]) -> None:
  for i, tol in ((0, 1e-8), (1, 1e-6)):
    ours, oracle = _physics(steps, i)
    np.testing.assert_allclose(ours, oracle, rtol=0.0, atol=tol)


def test_contacts_and_their_forces_are_those_of_mujoco_c_in_every_substep(steps: list[Step]) -> None:
  (found, shadow), (force, expected) = _feet(steps)
  assert np.array_equal(found, shadow)
  np.testing.assert_allclose(force, expected, rtol=0.0, atol=1e-4)
  assert 0.1 < found.mean() < 0.9
  for sensor in steps[0].contacts[0][0].strongest:
    ours, oracle = (
      np.array([[pair[side].strongest[sensor] for pair in step.contacts] for step in steps]) for side in range(2)
    )
    np.testing.assert_allclose(ours, oracle, rtol=0.0, atol=1e-4, err_msg=sensor)
    assert oracle.max() > 10.0, sensor


def test_episodes_end_where_the_table_says(played: Played, steps: list[Step]) -> None:
  assert [step.failed[0] for step in steps] == [step.failed[1] for step in steps]
  assert [step.timed_out[0] for step in steps] == [step.timed_out[1] for step in steps]
  assert sum(step.failed[0] for step in steps) >= 3
  assert sum(step.timed_out[0] for step in steps) >= 2


def test_a_reset_puts_the_robot_at_rest_in_its_default_pose_near_its_origin(played: Played, steps: list[Step]) -> None:
  robot = played.rollout.robot
  lo, hi = robot.start
  for step in (step for step in steps if step.failed[0] or step.timed_out[0]):
    qpos, qvel = step.after
    offset = qpos[:3] - step.origin
    assert np.abs(offset[:2]).max() <= 0.5
    assert lo - 1e-9 <= offset[2] <= hi + 1e-9
    assert np.allclose(qpos[[4, 5]], 0.0)
    np.testing.assert_allclose(qpos[7:], robot.default, atol=1e-12)
    assert not qvel.any()


def test_nothing_but_a_push_moves_a_robot_whose_episode_goes_on(steps: list[Step]) -> None:
  going = [step for step in steps if not step.failed[0] and not step.timed_out[0]]
  assert all(np.array_equal(step.before[0], step.after[0]) for step in going)
  assert all(np.array_equal(step.before[1][6:], step.after[1][6:]) for step in going)


def test_pushes_are_as_large_and_come_as_often_as_the_table_says() -> None:
  cfg = go1_flat().env
  # Robots that hover, so that physics costs little.
  cfg.sim.gravity, cfg.sim.timestep = (0.0, 0.0, 0.0), 0.02
  env = started_env(32, sim=cfg.sim, decimation=1, metrics={"state": MetricsTermCfg(note_state)})
  pushes, waits, since = [], [], np.zeros(32)
  for _ in range(250):
    _, _, terminated, truncated, _ = env.step(torch.zeros(32, 12))
    since += 0.02
    since[(terminated | truncated).numpy()] = 0.0
    change = env.sim.data.qvel.numpy() - STATE["qvel"]
    for world in np.flatnonzero(change.any(1) & (since > 0.0)):
      assert not change[world, 6:].any()
      turn = matrix(env.sim.data.qpos[world, 3:7].numpy())
      pushes.append(np.concatenate([change[world, :3], turn @ change[world, 3:6]]))
      waits.append(since[world])
      since[world] = 0.0
  assert len(pushes) > 30
  assert (np.abs(pushes).max(0) <= PUSH + 1e-9).all()
  assert (np.abs(pushes).max(0) > 0.8 * PUSH).all()
  # Timers of 1 to 3 s run from the step after the reset and are served in whole steps.
  assert 1.0 - 1e-6 <= min(waits) < 1.2
  assert 2.8 < max(waits) <= 3.0 + 0.02 + 1e-6


@pytest.mark.warp
@pytest.mark.parametrize("task", ["Mjlab-Velocity-Flat-Unitree-G1", "Mjlab-Velocity-Rough-Unitree-Go1"])
def test_every_term_is_its_formula_on_mujoco_warp(task: str) -> None:
  rollout = Rollout(task, 4, engine="warp")
  steps = [step for steps in roll(rollout, 24, timed_out_at=12) for step in steps]
  # In single precision, positions are as coarse as 4 micrometres where tiles are 40 m off. On flat ground rounding the
  # state alone moves the square of the G1's angular momentum by 2e-6 of itself, and the kinematic chain rounds on.
  check_rewards(steps, 5e-4 if TASKS[task].rough else 2e-5)
  check_critic(steps, 1e-4 if TASKS[task].rough else 2e-5)
  # Single precision may see a contact begin or end a substep apart, now and then. On height fields and edges of boxes
  # the two engines do not find the same contact points.
  share, mistaken = (0.75, 0.1) if TASKS[task].rough else (0.98, 0.005)
  for i, tol in ((0, 2e-5), (1, 2e-3)):
    ours, oracle = _physics(steps, i)
    assert np.quantile(np.abs(ours - oracle).max(1), share) < tol
  for world in rollout.worlds:
    for field in ("body_invweight0", "dof_invweight0", "actuator_acc0"):
      ours = getattr(rollout.env.sim.model, field)[world.index].double().numpy()
      np.testing.assert_allclose(ours, getattr(world.model, field), rtol=2e-4, atol=1e-6, err_msg=field)
  (found, shadow), (force, expected) = _feet(steps)
  assert (found != shadow).mean() < mistaken
  assert np.median(np.abs(force - expected).max((1, 2))) < 0.1
  for name, amplitude in AMPLITUDE.items():
    if name in steps[0].actor:
      noise = np.array([step.actor[name][0] - step.actor[name][1] for step in steps])
      assert np.abs(noise).max() < amplitude + 1e-4
  assert all(step.failed[0] == step.failed[1] and step.timed_out[0] == step.timed_out[1] for step in steps)


def _physics(steps: list[Step], part: int) -> tuple[np.ndarray, np.ndarray]:
  """Positions (0) or velocities (1) at the end of physics, ours and MuJoCo C's."""
  return np.array([step.before[part] for step in steps]), np.array([step.shadow[part] for step in steps])


def _feet(steps: list[Step]) -> list[tuple[np.ndarray, np.ndarray]]:
  """Contact of the feet, then their forces, by step and substep, ours and MuJoCo C's."""
  sides: list[list[np.ndarray]] = []
  for side in range(2):
    seen: list[list[Contacts]] = [[pair[side] for pair in step.contacts] for step in steps]
    sides.append([np.array([[getattr(c, name) for c in substeps] for substeps in seen]) for name in ("found", "force")])
  return list(zip(*sides, strict=True))
