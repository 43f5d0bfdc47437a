"""The replay memory against a slow reference that keeps every step of every world in lists."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch
from mjlab_rl.offpolicy.replay import Replay

WORLDS, DIM, ACTIONS = 5, 3, 2


@dataclass
class Step:
  obs: np.ndarray
  action: np.ndarray
  reward: float
  after: np.ndarray
  terminated: bool
  timed_out: bool


class Episodes:
  """Random episodes: observations are unique numbers, and some end, by termination or by time."""

  def __init__(self, seed: int, ends: float = 0.2) -> None:
    self.rng, self.ends = np.random.default_rng(seed), ends
    self.steps: list[list[Step]] = [[] for _ in range(WORLDS)]
    self.now = self._new(WORLDS)

  def _new(self, count: int) -> np.ndarray:
    return self.rng.integers(-1000, 1000, (count, DIM)).astype(np.float32)

  def advance(self, replay: Replay) -> None:
    draw = self.rng.random(WORLDS)
    terminated = draw < self.ends / 2
    timed_out = (draw >= self.ends / 2) & (draw < self.ends)
    action = self.rng.integers(-9, 9, (WORLDS, ACTIONS)).astype(np.float32)
    reward = self.rng.normal(size=WORLDS).astype(np.float32)
    after, fresh = self._new(WORLDS), self._new(WORLDS)
    following = np.where((terminated | timed_out)[:, None], fresh, after)
    for world, steps in enumerate(self.steps):
      is_over, is_cut = bool(terminated[world]), bool(timed_out[world])
      steps.append(Step(self.now[world], action[world], float(reward[world]), after[world], is_over, is_cut))
    # The environment returns the first observation of the next episode, and after a time-out the last one.
    given = np.where(timed_out[:, None], after, following)
    values: list[Any] = [self.now, action, reward, given, terminated, timed_out]
    replay.add(*map(torch.from_numpy, values))
    self.now = following


def expected(steps: list[Step], start: int, num_steps: int, gamma: float) -> tuple[float, float, np.ndarray]:
  total, discount, last = 0.0, 1.0, steps[start]
  for step in steps[start : start + num_steps]:
    total += discount * step.reward
    discount *= gamma
    last = step
    if step.terminated or step.timed_out:
      break
  return total, 0.0 if last.terminated else discount, last.after


@pytest.mark.parametrize("num_steps", [1, 3, 6])
@pytest.mark.parametrize(("added", "rows"), [(7, 64), (200, 32)])
@pytest.mark.parametrize("is_half", [False, True])
def test_transitions_are_those_of_a_slow_reference(added: int, rows: int, num_steps: int, is_half: bool) -> None:
  torch.manual_seed(0)
  episodes = Episodes(seed=added + num_steps)
  replay = Replay(WORLDS, rows, DIM, ACTIONS, "cpu", is_half=is_half)
  for _ in range(added):
    episodes.advance(replay)
  starts = {tuple(step.obs): (world, t) for world, steps in enumerate(episodes.steps) for t, step in enumerate(steps)}
  batch = replay.sample(4000, num_steps, 0.9)
  places = [starts[tuple(obs)] for obs in batch.obs.tolist()]
  drawn = set(places)
  known = {(world, t): expected(episodes.steps[world], t, num_steps, 0.9) for world, t in drawn}
  total, discount, after = (np.array(values) for values in zip(*(known[place] for place in places), strict=True))
  np.testing.assert_array_equal(batch.action, [episodes.steps[world][t].action for world, t in places])
  np.testing.assert_allclose(batch.reward, total, rtol=0, atol=1e-5)
  np.testing.assert_allclose(batch.discount, discount, rtol=0, atol=1e-6)
  goes_on = discount > 0
  np.testing.assert_array_equal(batch.next_obs.numpy()[goes_on], after[goes_on])
  # Every step that is kept and has all its following steps, but for the oldest, is drawn; none of the newest.
  for world, steps in enumerate(episodes.steps):
    mine = {t for w, t in drawn if w == world}
    cuts = sum(step.timed_out for step in steps[-rows:])
    oldest = 1 if added < rows else added - rows + cuts + 2
    assert set(range(oldest, added - num_steps + 1)) <= mine
    assert min(mine) >= max(0, added - rows)


def test_worlds_and_steps_are_drawn_alike() -> None:
  torch.manual_seed(0)
  episodes = Episodes(seed=1, ends=0.0)
  replay = Replay(WORLDS, 20, DIM, ACTIONS, "cpu")
  for _ in range(50):
    episodes.advance(replay)
  batch = replay.sample(18_000 * WORLDS, 1, 0.9)
  _, counts = np.unique(batch.obs.numpy(), axis=0, return_counts=True)
  assert len(counts) == 18 * WORLDS
  assert counts.min() > 800
  assert counts.max() < 1200


def test_a_restored_memory_draws_the_same(tmp_path: Any) -> None:
  episodes = Episodes(seed=2)
  replay, other = (Replay(WORLDS, 16, DIM, ACTIONS, "cpu", is_half=True) for _ in range(2))
  for _ in range(9):
    episodes.advance(replay)
  torch.save(replay.state_dict(), tmp_path / "replay.pt")
  state = torch.load(tmp_path / "replay.pt", weights_only=True)
  assert other.problem(state) is None
  other.load_state_dict(state)
  drawn = []
  for memory in (replay, other):
    torch.manual_seed(3)
    drawn.append(memory.sample(64, 2, 0.5))
  for name, value in vars(drawn[0]).items():
    assert torch.equal(value, vars(drawn[1])[name]), name
  assert "steps 16, now 15" in str(Replay(WORLDS, 15, DIM, ACTIONS, "cpu", is_half=True).problem(state))


def test_memory_is_counted_and_too_few_steps_are_not_ready() -> None:
  replay = Replay(WORLDS, 16, DIM, ACTIONS, "cpu", is_half=True)
  assert replay.num_bytes == WORLDS * 16 * ((DIM + ACTIONS) * 2 + 4 + 1)
  episodes = Episodes(seed=4)
  for _ in range(3):
    assert not replay.is_ready(3)
    episodes.advance(replay)
  episodes.advance(replay)
  assert replay.is_ready(3)


def test_values_beyond_half_precision_are_cut_not_infinite() -> None:
  replay = Replay(1, 8, 1, 1, "cpu", is_half=True)
  no = torch.zeros(1, dtype=torch.bool)
  for _ in range(4):
    huge = torch.full((1, 1), 1e9)
    replay.add(huge, -huge, torch.zeros(1), huge, no, no)
  batch = replay.sample(4, 1, 0.9)
  assert batch.obs.isfinite().all()
  assert (batch.action < -60_000).all()
