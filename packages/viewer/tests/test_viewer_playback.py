"""Time, errors and memory of a policy in a playback."""

from typing import Any

import pytest
import torch
from mjlab_viewer import SPEEDS, Playback, RandomPolicy, ZeroPolicy
from viewer_env import BoxEnv


class Clock:
  """Time that the test moves."""

  def __init__(self) -> None:
    self.now = 100.0

  def __call__(self) -> float:
    return self.now


def zero(env: BoxEnv) -> ZeroPolicy:
  return ZeroPolicy(env.num_envs, 1, env.sim.device)


def started(policy: Any = None) -> tuple[BoxEnv, Clock, Playback]:
  """Return a playback of one world, by default with actions of zero."""
  env, clock = BoxEnv(1), Clock()
  return env, clock, Playback(env, policy or zero(env), clock=clock)


def run(playback: Playback, clock: Clock, seconds: float, frame: float = 0.01) -> int:
  """Tick every `frame` [s] for some time, and return the number of steps."""
  done = 0
  for _ in range(round(seconds / frame)):
    clock.now += frame
    done += playback.tick()
  return done


@pytest.mark.parametrize("speed", SPEEDS)
def test_speed_scales_the_simulated_time(speed: float) -> None:
  env, clock, playback = started()
  playback.speed = speed
  playback.tick()
  run(playback, clock, 4.0)
  assert playback.step_count == pytest.approx(4.0 * speed / env.step_dt, abs=1)
  assert not playback.is_capped
  if speed >= 0.25:
    assert playback.real_time_factor == pytest.approx(speed, rel=0.25)


def test_time_that_a_slow_machine_cannot_make_up_for_is_dropped_and_flagged() -> None:
  env, clock, playback = started()
  zeros = zero(env)

  def slow(observations: object) -> torch.Tensor:
    clock.now += 0.1
    return zeros(observations)

  playback.policy = slow
  playback.tick()
  clock.now += 10.0
  assert playback.tick() == 1
  assert playback.is_capped
  playback.policy = zeros
  assert run(playback, clock, 1.0) == pytest.approx(50 + 5, abs=2)
  assert not playback.is_capped


def test_an_error_of_the_policy_pauses_until_reset_or_resume() -> None:
  env, clock, playback = started()
  zeros = zero(env)
  is_broken = True

  def policy(observations: object) -> torch.Tensor:
    if is_broken:
      raise RuntimeError("shapes do\nnot fit")
    return zeros(observations)

  playback.policy = policy
  playback.tick()
  assert run(playback, clock, 1.0) == 0
  assert playback.paused
  assert playback.error == "policy or environment: RuntimeError: shapes do not fit"
  is_broken = False
  playback.request(playback.reset)
  assert run(playback, clock, 1.0) > 40
  assert playback.error is None

  is_broken = True
  run(playback, clock, 0.1)
  assert playback.paused
  is_broken = False
  playback.request(playback.resume)
  assert run(playback, clock, 0.1) > 0


def test_an_error_of_a_control_pauses_and_is_shown() -> None:
  env, _, playback = started()
  playback.request(lambda: env.command.steer(0, 5))
  playback.tick()
  assert playback.paused
  assert playback.error is not None
  assert playback.error.startswith("control: TypeError")


def test_single_steps_are_taken_only_while_paused() -> None:
  _, clock, playback = started()
  playback.step_once()
  assert playback.step_count == 0
  playback.pause()
  playback.request(playback.step_once)
  playback.request(playback.step_once)
  assert run(playback, clock, 1.0) == 0
  assert playback.step_count == 2


def test_time_spent_paused_is_not_made_up_for() -> None:
  _, clock, playback = started()
  playback.tick()
  playback.pause()
  run(playback, clock, 10.0, frame=1.0)
  playback.resume()
  assert run(playback, clock, 1.0) == pytest.approx(50, abs=1)


def test_speeds_are_powers_of_two_within_bounds() -> None:
  _, _, playback = started()
  for steps, speed in ((1, 2.0), (-2, 0.5), (100, 8.0), (-100, 1 / 32)):
    playback.faster(steps)
    assert playback.speed == speed


class Counter:
  """A policy that counts the calls of each world since its last reset."""

  def __init__(self, num_envs: int) -> None:
    self.asked = torch.zeros(num_envs)

  def __call__(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
    self.asked += 1
    return torch.zeros(len(self.asked), 1)

  def reset(self, dones: torch.Tensor | None) -> None:
    self.asked[slice(None) if dones is None else dones] = 0


def test_the_memory_of_a_policy_is_reset_with_its_world() -> None:
  env, policy = BoxEnv(2, length=5), Counter(2)
  playback = Playback(env, policy)
  env.age[1] = 3
  playback.pause()
  for _ in range(3):
    playback.step_once()
  assert policy.asked.tolist() == [3, 1]
  playback.reset()
  assert policy.asked.tolist() == [0, 0]
  playback.step_once()
  other = Counter(2)
  other.asked += 7
  playback.set_policy(other)
  assert other.asked.tolist() == [0, 0]


def test_random_actions_fill_the_range_and_leave_the_global_generator_alone() -> None:
  before = torch.get_rng_state()
  policy = RandomPolicy(1000, 3, torch.device("cpu"))
  actions = policy(None)
  assert actions.shape == (1000, 3)
  assert actions.min() < -0.9
  assert actions.max() > 0.9
  assert actions.abs().max() <= 1.0
  assert torch.equal(torch.get_rng_state(), before)
