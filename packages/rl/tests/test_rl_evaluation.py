"""Evaluation: first episodes, their terminal states, intervals and thresholds, against manual results."""

import json
import math
from typing import Any

import pytest
import torch
from mjlab_core.errors import MjlabError
from mjlab_rl import Episodes, Evaluation, Interval, Threshold, bootstrap, play_first_episodes, summarize, wilson

LENGTHS = (1, 3, 2, 5)
FAILS = (True, False, True, False)


class Script:
  """Worlds that end after so many steps, and then again; the state is the step's number in the episode."""

  def __init__(self) -> None:
    self.num_envs, self.device, self.max_episode_length = 4, torch.device("cpu"), 5
    self.episode_length_buf = torch.zeros(4, dtype=torch.int64)
    self.terminal = torch.zeros(4)
    self.seeds: list[int | None] = []

  def reset(self, *, seed: int | None = None) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    self.seeds.append(seed)
    self.episode_length_buf.zero_()
    return self.get_observations(), {}

  def step(self, action: torch.Tensor) -> tuple[dict[str, torch.Tensor], Any, Any, Any, dict[str, Any]]:
    self.episode_length_buf += 1
    # What the step was like, before anything is reset.
    self.terminal = self.episode_length_buf.float() * 10.0
    done = self.episode_length_buf == torch.tensor(LENGTHS)
    fails = torch.tensor(FAILS)
    reward = action[:, 0] + self.episode_length_buf
    self.episode_length_buf[done] = 0
    return self.get_observations(), reward, done & fails, done & ~fails, {}

  def get_observations(self) -> dict[str, torch.Tensor]:
    return {"actor": self.episode_length_buf[:, None].float()}


class Recurrent:
  """A policy whose actions are 100, and that keeps what it is asked to reset."""

  def __init__(self) -> None:
    self.resets: list[list[bool]] = []

  def __call__(self, observations: Any) -> torch.Tensor:
    return torch.full((4, 1), 100.0)

  def reset(self, dones: torch.Tensor) -> None:
    self.resets.append(dones.tolist())


def play(max_steps: int = 10, policy: Any = None, **options: Any) -> tuple[Any, Episodes]:
  env: Any = Script()
  options |= {"max_steps": max_steps, "seed": 7}
  return env, play_first_episodes(env, policy or Recurrent(), lambda: {"state": env.terminal}, **options)


def test_only_the_first_episode_of_each_world_counts_with_its_terminal_state() -> None:
  env, played = play()
  assert env.seeds == [7]
  assert played.length.tolist() == list(LENGTHS)
  assert played.has_failed.tolist() == list(FAILS)
  assert played.has_ended.all()
  # Each step is worth 100 and its number.
  assert played.total.tolist() == [101.0, 306.0, 203.0, 515.0]
  # The world that fails on its first step has one sample, of the state it failed in.
  assert played.values["state"][:, 0].nan_to_num(-1.0).tolist() == [10.0, -1.0, -1.0, -1.0, -1.0]
  assert played.values["state"][:, 1].nan_to_num(-1.0).tolist() == [10.0, 20.0, 30.0, -1.0, -1.0]
  assert played.mean("state").tolist() == [10.0, 20.0, 15.0, 30.0]


def test_begin_is_called_once_before_the_first_step() -> None:
  calls: list[Any] = []
  play(3, begin=lambda: calls.append("begin"), progress=lambda *numbers: calls.append(numbers))
  assert calls == ["begin", (1, 3, 4), (2, 2, 4), (3, 1, 4)]


def test_an_episode_that_is_not_over_at_the_last_step_has_neither_ended_nor_failed() -> None:
  _, played = play(max_steps=2)
  assert played.has_ended.tolist() == [True, False, True, False]
  assert played.has_failed.tolist() == [True, False, True, False]
  assert played.length.tolist() == [1, 2, 2, 2]


def test_a_recurrent_policy_is_reset_where_episodes_ended() -> None:
  policy = Recurrent()
  play(2, policy)
  assert policy.resets == [[True, False, False, False], [True, False, True, False]]


def test_an_interval_is_that_of_the_mean() -> None:
  values = torch.randn(400, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * 2.0 + 5.0
  interval = bootstrap(values)
  assert interval.mean == pytest.approx(values.mean().item())
  error = values.std().item() / 20.0
  assert interval.low == pytest.approx(interval.mean - 1.96 * error, abs=0.1 * error)
  assert interval.high == pytest.approx(interval.mean + 1.96 * error, abs=0.1 * error)
  assert bootstrap(values) == interval


def test_a_share_of_all_or_none_has_an_interval() -> None:
  # Closed forms of the score interval: z^2 / (n + z^2) from either end, with z = 1.95996.
  none, all_of_them = wilson(torch.zeros(12)), wilson(torch.ones(12))
  edge = 1.959964**2 / (12 + 1.959964**2)
  assert (none.mean, none.low, none.high) == (0.0, 0.0, pytest.approx(edge))
  assert (all_of_them.mean, all_of_them.low, all_of_them.high) == (1.0, pytest.approx(1.0 - edge), 1.0)
  assert wilson(torch.tensor([math.nan])).count == 0


def test_an_interval_of_a_share_contains_it_as_often_as_promised() -> None:
  for rate in (0.05, 0.5, 0.9):
    covered = 0.0
    for ones in range(61):
      interval = wilson((torch.arange(60) < ones).double())
      covered += math.comb(60, ones) * rate**ones * (1 - rate) ** (60 - ones) * (interval.low <= rate <= interval.high)
    assert 0.93 < covered < 0.98


def test_rates_are_shares_and_the_rest_are_means() -> None:
  ones = torch.ones(8)
  (found,) = summarize({"success_rate": ones, "length": ones}, {}, units={}).groups.values()
  assert found["success_rate"] == wilson(ones)
  assert found["length"] == bootstrap(ones)


def test_missing_numbers_are_left_out_of_a_mean() -> None:
  assert bootstrap(torch.tensor([math.nan, 2.0, 2.0])) == Interval(mean=2.0, low=2.0, high=2.0, count=2)
  assert bootstrap(torch.tensor([math.nan])).count == 0


def evaluation() -> Evaluation:
  _, played = play()
  odd = torch.tensor([False, True, False, True])
  return summarize(
    {"success_rate": (~played.has_failed).double(), "state": played.mean("state"), "none": torch.full((4,), math.nan)},
    {"odd": odd, "everything": ~odd | odd, "even": ~odd},
    units={"state": "m"},
    values={"state": played.values["state"]},
    steps_per_second=2,
  )


def test_groups_are_summarized_and_curves_are_means_over_worlds_that_still_play() -> None:
  result = evaluation()
  assert list(result.groups) == ["all", "odd", "even"]
  assert result.groups["all"]["success_rate"].mean == 0.5
  assert result.groups["odd"]["success_rate"].mean == 1.0
  assert result.groups["even"]["state"].mean == 12.5
  # Seconds of two steps: 10 10 10 10 20 20 20; 30 30 40; 50.
  assert result.curves["state"]["all"] == pytest.approx([100 / 7, 100 / 3, 50.0])
  assert result.curves["state"]["even"][:1] == pytest.approx([40 / 3])
  table = result.table().splitlines()
  assert table[0].split() == ["episodes", "success_rate", "state", "[m]", "none"]
  assert table[1].startswith("all   4")
  assert table[1].endswith("-")


def test_an_evaluation_is_strict_json() -> None:
  data = json.loads(json.dumps(evaluation().to_json(), allow_nan=False))
  assert data["groups"]["even"]["state"]["mean"] == 12.5
  assert data["groups"]["all"]["none"]["mean"] is None
  assert data["curves"]["state"]["even"][1:] == [None, None]


@pytest.mark.parametrize(
  ("text", "reached"),
  [
    ("success_rate>=0.5", True),
    ("success_rate >= 0.51", False),
    ("odd:success_rate>=1", True),
    ("state<=18.7", False),
    ("state<=18.75", True),
    ("none<=1", False),
    ("none>=0", False),
  ],
)
def test_a_threshold_is_reached_or_not(text: str, reached: bool) -> None:
  outcome, line = Threshold.parse(text).check(evaluation())
  assert outcome is reached
  assert line.endswith("yes" if reached else "NO")


@pytest.mark.parametrize(
  ("text", "message"),
  [
    ("success_rate", "expected"),
    ("success_rate>0.5", "expected"),
    ("success_rate>=high", "expected"),
    ("succes_rate>=0.5", "metric 'succes_rate' does not exist. Nearest: success_rate"),
    ("od:success_rate>=0.5", "group 'od' does not exist. Nearest: odd"),
  ],
)
def test_a_malformed_or_unknown_threshold_is_refused(text: str, message: str) -> None:
  with pytest.raises(MjlabError) as caught:
    Threshold.parse(text).check(evaluation())
  assert message in str(caught.value)
