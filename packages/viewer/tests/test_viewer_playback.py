"""Time, errors and memory of a policy while somebody watches."""

import pytest
import torch
from mjlab_viewer import SPEEDS, Playback, RandomPolicy, ZeroPolicy
from viewer_env import BoxEnv


class Clock:
  """Time that passes when it is told to, and for every step a little."""

  def __init__(self) -> None:
    self.now = 100.0

  def __call__(self) -> float:
    return self.now


def zero(env: BoxEnv) -> ZeroPolicy:
  return ZeroPolicy(env.num_envs, 1, env.sim.device)


def run(playback: Playback, clock: Clock, seconds: float, frame: float = 0.01) -> int:
  """Ticks of `frame` [s] for some time; returns the steps done."""
  done = 0
  for _ in range(round(seconds / frame)):
    clock.now += frame
    done += playback.tick()
  return done


@pytest.mark.parametrize("speed", SPEEDS)
def test_at_a_speed_so_many_seconds_pass_in_each_second(speed: float) -> None:
  env, clock = BoxEnv(1), Clock()
  playback = Playback(env, zero(env), clock=clock)
  playback.speed = speed
  playback.tick()
  run(playback, clock, 4.0)
  assert playback.step_count == pytest.approx(4.0 * speed / env.step_dt, abs=1)
  assert not playback.is_capped
  if speed >= 0.25:
    assert playback.real_time_factor == pytest.approx(speed, rel=0.25)


def test_time_that_the_machine_cannot_make_up_for_is_dropped_and_flagged() -> None:
  env, clock = BoxEnv(1), Clock()
  zeros = zero(env)

  def slow(observations: object) -> torch.Tensor:
    clock.now += 0.1
    return zeros(observations)

  playback = Playback(env, slow, clock=clock)
  playback.tick()
  clock.now += 10.0
  assert playback.tick() == 1
  assert playback.is_capped
  playback.policy = zeros
  assert run(playback, clock, 1.0) == pytest.approx(50 + 5, abs=2)
  assert not playback.is_capped


def test_an_error_in_the_policy_pauses_is_kept_and_is_forgotten_by_reset() -> None:
  env, clock = BoxEnv(1), Clock()
  zeros = zero(env)
  is_broken = True

  def policy(observations: object) -> torch.Tensor:
    if is_broken:
      raise RuntimeError("shapes do\nnot fit")
    return zeros(observations)

  playback = Playback(env, policy, clock=clock)
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


def test_an_error_in_a_control_pauses_and_is_shown() -> None:
  env, clock = BoxEnv(1), Clock()
  playback = Playback(env, zero(env), clock=clock)
  playback.request(lambda: env.command.steer(0, 5))
  playback.tick()
  assert playback.paused
  assert playback.error is not None
  assert playback.error.startswith("control: TypeError")


def test_single_steps_are_taken_only_while_paused() -> None:
  env, clock = BoxEnv(1), Clock()
  playback = Playback(env, zero(env), clock=clock)
  playback.step_once()
  assert playback.step_count == 0
  playback.pause()
  playback.request(playback.step_once)
  playback.request(playback.step_once)
  assert run(playback, clock, 1.0) == 0
  assert playback.step_count == 2


def test_time_spent_paused_is_not_made_up_for() -> None:
  env, clock = BoxEnv(1), Clock()
  playback = Playback(env, zero(env), clock=clock)
  playback.tick()
  playback.pause()
  run(playback, clock, 10.0, frame=1.0)
  playback.resume()
  assert run(playback, clock, 1.0) == pytest.approx(50, abs=1)


def test_speeds_are_powers_of_two_and_end() -> None:
  env = BoxEnv(1)
  playback = Playback(env, zero(env))
  playback.faster()
  assert playback.speed == 2.0
  playback.faster(-2)
  assert playback.speed == 0.5
  playback.faster(100)
  assert playback.speed == 8.0
  playback.faster(-100)
  assert playback.speed == 1 / 32


class Counter:
  """A policy that remembers how often each world asked since its last reset."""

  def __init__(self, num_envs: int) -> None:
    self.asked = torch.zeros(num_envs)

  def __call__(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
    self.asked += 1
    return torch.zeros(len(self.asked), 1)

  def reset(self, dones: torch.Tensor | None) -> None:
    self.asked[slice(None) if dones is None else dones] = 0


def test_a_policy_that_remembers_forgets_with_the_world_whose_episode_ended() -> None:
  env, clock = BoxEnv(2, length=5), Clock()
  policy = Counter(2)
  playback = Playback(env, policy, clock=clock)
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


def test_random_actions_draw_nothing_from_anybody_elses_generator_and_fill_the_range() -> None:
  policy = RandomPolicy(1000, 3, torch.device("cpu"))
  actions = policy(None)
  assert actions.shape == (1000, 3)
  assert actions.min() < -0.9
  assert actions.max() > 0.9
  assert actions.abs().max() <= 1.0
