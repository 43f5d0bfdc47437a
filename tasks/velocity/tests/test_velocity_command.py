"""The velocity command: what is drawn, how often, and what follows the robot's heading."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_envs import ManagerBasedRlEnv
from mjlab_velocity import go1_flat
from mjlab_velocity.mdp import UniformVelocityCommand, VelocityRanges, VelocityStage
from velocity_rollout import make_env, started_env

ROUNDS = 250


@pytest.fixture(scope="module")
def env() -> ManagerBasedRlEnv:
  return started_env(64)


def twist(env: ManagerBasedRlEnv) -> UniformVelocityCommand:
  term: Any = env.command_manager.get_term("twist")
  return term


def face(env: ManagerBasedRlEnv, yaw: torch.Tensor) -> None:
  """Turn the robots about the vertical."""
  quat = env.sim.data.qpos[:, 3:7]
  quat.zero_()
  quat[:, 0], quat[:, 3] = torch.cos(yaw / 2), torch.sin(yaw / 2)


def follow(env: ManagerBasedRlEnv) -> np.ndarray:
  """Bring the command up to date without time passing."""
  env.command_manager.compute(0.0, torch.ones(env.num_envs, dtype=torch.bool))
  return env.command_manager.get_command("twist").double().numpy().copy()


@pytest.fixture(scope="module")
def draws(env: ManagerBasedRlEnv) -> dict[str, np.ndarray]:
  """Commands of 16000 draws, seen at two headings of the robots, and what was drawn for them."""
  seen: dict[str, list[np.ndarray]] = {name: [] for name in ("first", "second", "ahead", "holds", "target")}
  term, everywhere = twist(env), torch.ones(env.num_envs, dtype=torch.bool)
  for _ in range(ROUNDS):
    env.command_manager.reset(everywhere)
    for name, yaw in (("first", 0.3), ("second", 0.35)):
      face(env, torch.full((env.num_envs,), yaw, dtype=torch.float64))
      seen[name].append(follow(env))
    drawn = {"ahead": term._drawn[:, 1] == 0.0, "holds": term._holds_heading, "target": term._heading_target}
    for name, values in drawn.items():
      seen[name].append(values.numpy().copy())
  return {name: np.concatenate(rows) for name, rows in seen.items()}


def share(flags: np.ndarray) -> Callable[[float], bool]:
  def near(expected: float) -> bool:
    return bool(abs(flags.mean() - expected) < 4.0 * np.sqrt(expected * (1.0 - expected) / flags.size))

  return near


def test_a_tenth_of_the_draws_stand(draws: dict[str, np.ndarray]) -> None:
  stands = (draws["first"] == 0.0).all(1)
  assert share(stands)(0.1)
  assert np.array_equal(stands, (draws["second"] == 0.0).all(1))


def test_a_fifth_of_the_draws_go_straight_ahead_at_no_less_than_the_least_speed(draws: dict[str, np.ndarray]) -> None:
  command = draws["first"][~(draws["first"] == 0.0).all(1)]
  ahead = command[:, 1] == 0.0
  assert share(ahead)(0.2)
  # It does not turn, whatever its heading.
  assert not command[ahead, 2].any()
  assert not draws["second"][draws["second"][:, 1] == 0.0, 2].any()
  speed = command[ahead, 0]
  assert speed.min() == pytest.approx(0.3)
  assert speed.max() <= 1.0
  # |v| of a uniform v in [-1, 1] is below 0.3 in three draws of ten.
  assert share(np.isclose(speed, 0.3))(0.3)


def test_three_of_ten_draws_that_do_not_go_ahead_hold_a_heading_and_no_others(draws: dict[str, np.ndarray]) -> None:
  assert share(draws["holds"][~draws["ahead"]])(0.3)
  assert not draws["holds"][draws["ahead"]].any()
  counts, _ = np.histogram(draws["target"], bins=8, range=(-np.pi, np.pi))
  assert counts.sum() == 64 * ROUNDS
  assert (np.abs(counts - 8 * ROUNDS) < 180).all()


def test_speeds_are_uniform_in_their_ranges(draws: dict[str, np.ndarray]) -> None:
  first, second = draws["first"], draws["second"]
  free = (first[:, 1] != 0.0) & (first[:, 2] == second[:, 2]) & (np.abs(first[:, 2]) < 0.5 - 1e-6)
  for column, limit in ((0, 1.0), (1, 1.0), (2, 0.5)):
    values = first[free, column] / limit
    assert np.abs(values).max() <= 1.0
    counts, _ = np.histogram(values, bins=20, range=(-1.0, 1.0))
    expected = len(values) / 20
    # Chi squared with 19 degrees of freedom exceeds 44 once in a thousand times.
    assert ((counts - expected) ** 2 / expected).sum() < 44.0


def test_turning_follows_the_heading_error_the_short_way_and_within_its_range(env: ManagerBasedRlEnv) -> None:
  term, everywhere = twist(env), torch.ones(env.num_envs, dtype=torch.bool)
  generator = torch.Generator().manual_seed(1)
  seen: list[float] = []
  for _ in range(30):
    env.command_manager.reset(everywhere)
    yaw = (torch.rand(env.num_envs, generator=generator, dtype=torch.float64) * 2 - 1) * np.pi
    face(env, yaw)
    command = follow(env)
    holds = (term._holds_heading & ~term._stands).numpy()
    error = term._heading_target.double().numpy() - yaw.numpy()
    turn = np.clip(0.5 * np.arctan2(np.sin(error), np.cos(error)), -0.5, 0.5)
    np.testing.assert_allclose(command[holds, 2], turn[holds], atol=1e-6)
    seen += turn[holds].tolist()
  assert min(seen) == -0.5
  assert max(seen) == 0.5
  assert np.mean(np.abs(seen) < 0.49) > 0.2


def test_a_command_lasts_three_to_eight_seconds(env: ManagerBasedRlEnv) -> None:
  term = twist(env)
  env.command_manager.reset(torch.ones(env.num_envs, dtype=torch.bool))
  drawn, last, waits = term.command_counter.clone(), np.zeros(env.num_envs), []
  for step in range(1, 1500):
    env.command_manager.compute(0.02)
    new = (term.command_counter > drawn).numpy()
    waits += (step * 0.02 - last[new]).tolist()
    last[new] = step * 0.02
    drawn = term.command_counter.clone()
  assert min(waits) >= 3.0 - 1e-3
  assert max(waits) <= 8.0 + 0.02 + 1e-3
  assert np.mean(waits) == pytest.approx(5.5, abs=0.4)


def test_a_reset_draws_new_commands_in_its_worlds_only(env: ManagerBasedRlEnv) -> None:
  term = twist(env)
  mask = torch.arange(env.num_envs) % 2 == 0
  before, left = term._drawn.clone(), term.time_left.clone()
  env.command_manager.reset(mask)
  assert torch.equal(term._drawn[~mask], before[~mask])
  assert torch.equal(term.time_left[~mask], left[~mask])
  assert (term._drawn[mask] != before[mask]).any(1).float().mean() > 0.9
  assert (term.command_counter[mask] == 1).all()


def test_logged_errors_are_means_over_the_steps_of_each_episode() -> None:
  env = started_env(1)
  generator = torch.Generator().manual_seed(0)
  for length in (6, 3):
    env.drain_log()
    errors = []
    for _ in range(length):
      command = env.command_manager.get_command("twist")[0].double().numpy().copy()
      env.step(torch.randn(1, 12, generator=generator) * 0.5)
      w, x, y, z = env.sim.data.qpos[0, 3:7].tolist()
      to_body = np.array(
        [
          [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
          [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
        ]
      )
      velocity = to_body @ env.sim.data.qvel[0, :3].numpy()
      turning = env.sim.data.qvel[0, 5].item()
      errors.append((np.linalg.norm(command[:2] - velocity), abs(command[2] - turning)))
    assert "Metrics/twist/error_vel_xy" not in env.drain_log()
    env.episode_length_buf.fill_(999)
    env.step(torch.zeros(1, 12))
    log = env.drain_log()
    # The step that ends an episode has no state left to be measured on.
    expected = np.mean(errors, 0)
    assert log["Metrics/twist/error_vel_xy"] == pytest.approx(expected[0], rel=1e-5)
    assert log["Metrics/twist/error_vel_yaw"] == pytest.approx(expected[1], rel=1e-5)


def test_stages_of_the_command_follow_the_step_counter() -> None:
  env = started_env(2)
  expected = {
    0: ((-1.0, 1.0), (-1.0, 1.0), (-0.5, 0.5)),
    119_999: ((-1.0, 1.0), (-1.0, 1.0), (-0.5, 0.5)),
    120_000: ((-1.5, 2.0), (-1.0, 1.0), (-0.7, 0.7)),
    239_999: ((-1.5, 2.0), (-1.0, 1.0), (-0.7, 0.7)),
    240_000: ((-2.0, 3.0), (-1.0, 1.0), (-0.7, 0.7)),
  }
  for counter, ranges in expected.items():
    env.common_step_counter.fill_(max(counter - 1, 0))
    env.step(torch.zeros(2, 12))
    np.testing.assert_allclose(twist(env).ranges[:3].numpy(), ranges, rtol=1e-6)
    log = env.drain_log()
    upper = [log[f"Curriculum/command_vel/{name}"] for name in ("lin_vel_x", "lin_vel_y", "ang_vel_z")]
    np.testing.assert_allclose(upper, [hi for _, hi in ranges], rtol=1e-6)


def test_a_run_that_goes_on_begins_in_the_stage_it_had_reached() -> None:
  first = make_env(2)
  first.common_step_counter.fill_(240_000)
  second = make_env(64)
  second.load_progress(first.state_dict())
  second.reset()
  np.testing.assert_allclose(twist(second).ranges[0].numpy(), (-2.0, 3.0))
  assert twist(second)._drawn[:, 0].max() > 2.0


INVERTED = VelocityRanges(lin_vel_y=(1.0, -1.0))


@pytest.mark.parametrize(
  ("changes", "stages", "message"),
  [
    *(
      ({name: 1.5}, None, f"{name} must be in [0, 1], got 1.5")
      for name in ("standing_fraction", "heading_fraction", "forward_fraction")
    ),
    ({"ranges": INVERTED}, None, "ranges: lin_vel_y must not fall, got (1.0, -1.0)"),
    ({}, [VelocityStage(step=0), VelocityStage(step=5, ang_vel_z=(0.5, -0.5))], "stage at step 5: ang_vel_z"),
    *(
      ({}, [VelocityStage(step=step) for step in steps], f"must begin at 0 and rise, got {list(steps)}")
      for steps in ((), (1,), (0, 5, 5))
    ),
  ],
)
def test_impossible_commands_and_stages_are_refused_by_name(
  changes: dict[str, Any], stages: list[VelocityStage] | None, message: str
) -> None:
  cfg = go1_flat().env
  term, curriculum = cfg.commands["twist"], cfg.curriculum["command_vel"]
  assert term is not None
  assert curriculum is not None
  for name, value in changes.items():
    setattr(term, name, value)
  if stages is not None:
    curriculum.params["stages"] = stages
  with pytest.raises(ConfigError, match=re.escape(message)):
    make_env(1, commands=cfg.commands, curriculum=cfg.curriculum)


def test_a_steered_command_holds_in_its_world_until_steering_ends() -> None:
  env = started_env(2)
  command = twist(env)
  own = follow(env)
  command.steer(1, (0.5, -0.25, 0.125))
  np.testing.assert_array_equal(follow(env), [own[0], [0.5, -0.25, 0.125]])
  env.command_manager.reset(torch.ones(2, dtype=torch.bool))
  np.testing.assert_array_equal(follow(env)[1], [0.5, -0.25, 0.125])
  assert command.speed[1] == pytest.approx(np.hypot(0.5, 0.25) + 0.125)
  command.steer(1, None)
  assert (follow(env)[1] != [0.5, -0.25, 0.125]).all()
  names, lower, upper = zip(*command.axes, strict=True)
  assert len(names) == 3
  np.testing.assert_allclose([lower, upper], command.ranges[:3].T)
