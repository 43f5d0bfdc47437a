"""When gait is judged: gates, speed classes, and what counts as a swing."""

from typing import Any

import numpy as np
import pytest
import torch
from mjlab_envs import ManagerBasedRlEnv
from mjlab_velocity import go1_flat
from mjlab_velocity.mdp import UniformVelocityCommandCfg, VelocityRanges
from velocity_facts import TASKS
from velocity_oracle import World
from velocity_rollout import make_env, started_env

GAIT = ("foot_clearance", "foot_swing_height", "foot_slip", "soft_landing")


def commanded(speed: float) -> dict[str, UniformVelocityCommandCfg]:
  """Return commands to turn at `speed` in all worlds."""
  ranges = VelocityRanges(lin_vel_x=(0.0, 0.0), lin_vel_y=(0.0, 0.0), ang_vel_z=(speed, speed))
  return {
    "twist": UniformVelocityCommandCfg(ranges=ranges, standing_fraction=0, heading_fraction=0, forward_fraction=0)
  }


def values(env: ManagerBasedRlEnv) -> dict[str, np.ndarray]:
  """Weighted rewards of the last step by term."""
  columns = env.reward_manager.step_reward.double().numpy().T.copy()
  return dict(zip(env.reward_manager.active_terms, columns, strict=True))


def hop(speed: float, weights: dict[str, float]) -> dict[str, np.ndarray]:
  """Sum over a hop, from standing, of each weighted reward."""
  rewards = go1_flat().env.rewards
  for name, weight in weights.items():
    term: Any = rewards[name]
    term.weight = weight
  env = started_env(4, commands=commanded(speed), curriculum={}, rewards=rewards)
  total: dict[str, np.ndarray] = {}
  for step in range(60):
    if step == 25:
      env.sim.data.qvel[:, :3] += torch.tensor([0.3, 0.0, 1.2], dtype=torch.float64)
    env.step(torch.zeros(4, 12))
    for name, value in values(env).items():
      total[name] = total.get(name, 0.0) + value
  return total


@pytest.mark.parametrize(("terms", "gate", "sign"), [(GAIT, 0.05, -1.0), (("air_time",), 0.5, 1.0)])
def test_gait_counts_above_its_gate_only(terms: tuple[str, ...], gate: float, sign: float) -> None:
  below, above = (hop(speed, {"air_time": 1.0}) for speed in (gate - 0.001, gate + 0.001))
  for name in terms:
    assert not below[name].any(), name
    assert (sign * above[name] > 0.0).all(), name


@pytest.mark.parametrize(("speed", "std"), [(0.049, 0.1), (0.051, 0.4), (1.49, 0.4), (1.51, 0.9)])
def test_the_posture_is_judged_by_the_commanded_speed(speed: float, std: float) -> None:
  cfg = go1_flat().env
  pose: Any = cfg.rewards["pose"]
  pose.params |= {"std_standing": {".*": 0.1}, "std_walking": {".*": 0.4}, "std_running": {".*": 0.9}}
  env = started_env(4, commands=commanded(speed), curriculum={}, rewards=cfg.rewards)
  env.step(torch.randn(4, 12, generator=torch.Generator().manual_seed(2)) * 0.3)
  error = env.sim.data.qpos[:, 7:].numpy() - env.scene["robot"].data.default_joint_pos.numpy()
  np.testing.assert_allclose(values(env)["pose"], np.exp(-((error / std) ** 2).mean(1)), rtol=1e-6)


def test_the_drop_at_the_start_of_an_episode_is_neither_swing_nor_landing() -> None:
  env = started_env(16, commands=commanded(0.4), curriculum={})
  assert not env.scene["feet_ground_contact"].data.found.any()
  landed = torch.zeros(16, 4, dtype=torch.bool)
  for _ in range(20):
    env.step(torch.zeros(16, 12))
    landed |= env.scene["feet_ground_contact"].data.found > 0
    assert not values(env)["foot_swing_height"].any()
    assert not values(env)["soft_landing"].any()
  assert landed.all()


def test_an_episode_does_not_depend_on_the_one_before() -> None:
  seen = []
  for lift, spread in ((0.0, 0.1), (0.4, 2.0)):
    env = started_env(4)
    generator = torch.Generator().manual_seed(5)
    for _ in range(8):
      # Thrown up, so that air times and swings differ as well.
      env.sim.data.qpos[:, 2] += lift
      env.step(torch.randn(4, 12, generator=generator) * spread)
    env.episode_length_buf.fill_(999)
    after = []
    for _ in range(40):
      observations, reward, _, _, _ = env.step(torch.randn(4, 12, generator=generator) * (0.5 if after else spread))
      after.append([observations["actor"], observations["critic"], *([reward] if after else [])])
      if not after[1:]:
        generator.manual_seed(6)
    seen.append(after)
  for one, other in zip(*seen, strict=True):
    assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


def test_swings_are_forgotten_where_an_episode_ends_and_nowhere_else() -> None:
  env = started_env(2)
  env.step(torch.zeros(2, 12))
  swing: Any = env.reward_manager.get_term_cfg("foot_swing_height").func
  swing._peak.fill_(0.4)
  env.reset(env_ids=[1])
  assert swing._peak.tolist() == [[0.4] * 4, [0.0] * 4]


def test_a_robot_has_fallen_over_beyond_seventy_degrees_in_any_direction() -> None:
  env = started_env(8)
  tilt = torch.deg2rad(torch.tensor([69.9, 70.1] * 4, dtype=torch.float64))
  way = torch.tensor([0.0, 0.0, 0.5, 0.5, 1.0, 1.0, -0.7, -0.7], dtype=torch.float64) * torch.pi
  axis = torch.stack([way.cos(), way.sin(), torch.zeros_like(way)], 1)
  env.sim.data.qpos[:, 2] = 2.0
  env.sim.data.qpos[:, 3] = torch.cos(tilt / 2)
  env.sim.data.qpos[:, 4:7] = torch.sin(tilt / 2)[:, None] * axis
  _, _, terminated, truncated, _ = env.step(torch.zeros(8, 12))
  assert terminated.tolist() == [False, True] * 4
  assert not truncated.any()


@pytest.mark.parametrize("task", [name for name in TASKS if "Flat" in name])
def test_feet_begin_one_to_five_centimetres_above_the_ground_in_a_thousand_resets(task: str) -> None:
  robot = TASKS[task].robot
  env = make_env(50, task=task)
  world = World(env, 0, robot)
  clearances = []
  for _ in range(20):
    env.reset()
    for qpos, qvel in zip(env.sim.data.qpos.numpy(), env.sim.data.qvel.numpy(), strict=True):
      world.look(qpos, qvel)
      assert not world.touches_ground()
      clearances.append(world.lowest)
  assert len(clearances) == 1000
  assert min(clearances) == pytest.approx(robot.sole, abs=2e-4)
  assert max(clearances) == pytest.approx(robot.sole + 0.04, abs=2e-4)
