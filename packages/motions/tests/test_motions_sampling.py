"""Starts of episodes: against a NumPy reference, for any number of worlds, across saving."""

from typing import Any

import numpy as np
import pytest
import torch
from mjlab_core.constraints import field_problems
from mjlab_motions.library import MotionLibrary
from mjlab_motions.sampling import AdaptiveSamplingCfg, MotionSampler, SamplingMode
from motions_robot import robot, wiggle

# Bins: 3 of the first clip, 1 of the second, 2 of the third.
FRAMES = (151, 41, 101)


def library(weights: list[float] | None = None) -> MotionLibrary:
  motions = [wiggle(frames=frames) for frames in FRAMES]
  return MotionLibrary(motions, robot(), ("pelvis",), rate=50.0, weights=weights)


def sampler(num_envs: int = 4, mode: SamplingMode = "adaptive", **cfg: Any) -> MotionSampler:
  return MotionSampler(library(), AdaptiveSamplingCfg(**cfg), mode, num_envs)


def play(books: MotionSampler, steps: int, copies: int = 1, seed: int = 0) -> list[tuple[np.ndarray, ...]]:
  """Count random visits and failures in `copies` equal groups of 4 worlds, and return the events of one group."""
  rng = np.random.default_rng(seed)
  happened = []
  for _ in range(steps):
    clip = rng.integers(0, 3, size=4)
    frame = (rng.random(4) * (np.array(FRAMES)[clip] - 1)).astype(np.int64)
    ended = rng.random(4) < 0.3
    failed = ended & (rng.random(4) < 0.2 + 0.6 * (clip == 2))
    happened.append((clip, frame, ended, failed))
    worlds = [torch.from_numpy(np.tile(value, copies)) for value in (clip, frame, ended, failed)]
    books.count_ends(*worlds)
    books.count_step(worlds[0], worlds[1], ~worlds[2])
  return happened


def reference(happened: list[tuple[np.ndarray, ...]], cfg: AdaptiveSamplingCfg) -> np.ndarray:
  """Return probabilities of bins by the definition, step by step and world by world."""
  first_bin, counts, lengths = [0, 3, 4], [3, 1, 2], np.array(FRAMES)
  edges = [[(n - 1) * i // c for i in range(c + 1)] for n, c in zip(lengths, counts, strict=True)]
  visits, failures = np.zeros(6), np.zeros(6)
  for clip, frame, ended, failed in happened:
    seen, lost = np.zeros(6), np.zeros(6)
    for world in range(4):
      c = clip[world]
      b = first_bin[c] + max(i for i in range(counts[c]) if edges[c][i] <= frame[world])
      seen[b] += 1 / 4
      lost[b] += (ended[world] and failed[world]) / 4
    visits += cfg.memory * (seen - visits)
    failures += cfg.memory * (lost - failures)
  credit = cfg.prior * visits.sum() / 6
  rate = (failures + credit * failures.sum() / visits.sum()) / (visits + credit)
  spread = np.zeros(6)
  for c in range(3):
    for b in range(counts[c]):
      weights = np.array([cfg.decay**i for i in range(cfg.lookahead)])
      for i, weight in enumerate(weights / weights.sum()):
        spread[first_bin[c] + b] += weight * rate[first_bin[c] + min(b + i, counts[c] - 1)]
  share = np.concatenate([np.diff(e) for e in edges]).astype(float)
  share /= share.sum()
  hard = share * spread / (share * spread).sum()
  return cfg.uniform_share * share + (1 - cfg.uniform_share) * hard


@pytest.mark.parametrize("lookahead", [1, 3])
def test_probabilities_are_those_of_the_definition(lookahead: int) -> None:
  cfg = AdaptiveSamplingCfg(memory=0.005, lookahead=lookahead)
  books = MotionSampler(library(), cfg, "adaptive", 4)
  expected = reference(play(books, 400), cfg)
  np.testing.assert_allclose(books.probabilities(), expected, rtol=1e-4)
  assert books.probabilities().sum() == pytest.approx(1.0)
  # The third clip fails most.
  assert books.probabilities()[4:].sum() > 1.3 * books.library.bin_share[4:].sum()


def test_the_number_of_worlds_changes_nothing() -> None:
  few, many = sampler(4), sampler(4 * 64)
  play(few, 50)
  play(many, 50, copies=64)
  torch.testing.assert_close(few.probabilities(), many.probabilities(), atol=1e-6, rtol=1e-5)
  # The counts themselves, so that those of many worlds go on in few.
  for name, value in few.state_dict().items():
    torch.testing.assert_close(value, many.state_dict()[name], atol=1e-8, rtol=1e-5)


def test_the_failure_rate_of_a_bin_does_not_depend_on_its_visits() -> None:
  books = sampler(8, memory=0.01, prior=1e-6, lookahead=1)
  # Seven worlds in the first bin, one in the second; a seventh of the first and one in seven steps of the second fail.
  clip, frame = torch.zeros(8, dtype=torch.int64), torch.tensor([10] * 7 + [60])
  for step in range(4000):
    failed = torch.zeros(8, dtype=torch.bool)
    failed[step % 7] = True
    failed[7] = step % 7 == 0
    books.count_ends(clip, frame, failed, failed)
    books.count_step(clip, frame, ~failed)
  rates = books.failure_rate()
  assert rates[0] == pytest.approx(1 / 7, rel=0.01)
  assert rates[1] == pytest.approx(1 / 7, rel=0.05)


def test_before_any_failure_all_moments_are_equally_likely() -> None:
  books = sampler()
  torch.testing.assert_close(books.probabilities(), books.library.bin_share)


def test_failures_raise_the_odds_of_starts_before_them_in_their_clip_alone() -> None:
  yes = torch.tensor([True])

  def odds_after_failure(clip: int, frame: int) -> torch.Tensor:
    books = sampler(1, lookahead=3, memory=1e-5)
    for c, f in [(c, f) for c, n in enumerate(FRAMES) for f in range(0, n - 1, 10)]:
      books.count_step(torch.tensor([c]), torch.tensor([f]), yes)
    books.count_ends(torch.tensor([clip]), torch.tensor([frame]), yes, yes)
    books.count_step(torch.tensor([clip]), torch.tensor([frame]), yes)
    return books.probabilities() / books.library.bin_share

  p = odds_after_failure(1, 20)
  # The only bin of the second clip failed; those of the first, just before it in memory, did not.
  assert p[3] > 2.0 * p[2]
  assert p[:3].tolist() == pytest.approx([p[0].item()] * 3, rel=1e-3)
  p = odds_after_failure(0, 149)
  assert p[2] > p[1] > p[0] > p[4]


@pytest.mark.parametrize("mode", ["adaptive", "uniform", "start"])
def test_starts_are_before_the_last_frame_with_the_probabilities_of_their_mode(mode: SamplingMode) -> None:
  books = sampler(200_000, mode)
  clip, frame = books.draw(torch.Generator().manual_seed(0))
  assert (frame >= 0).all()
  assert (frame < books.library.lengths[clip] - 1).all()
  share = torch.bincount(clip, minlength=3) / clip.numel()
  torch.testing.assert_close(share, books.library.clip_share, atol=0.005, rtol=0)
  if mode == "start":
    assert (frame == 0).all()
  else:
    counts = torch.bincount(frame[clip == 0], minlength=150)
    assert counts.numel() == 150
    expected = (clip == 0).sum().item() / 150
    assert (counts - expected).abs().max() < 5.0 * expected**0.5


def test_sampling_goes_on_from_saved_counts() -> None:
  whole, first, second = sampler(), sampler(), sampler()
  play(whole, 20, seed=1)
  play(whole, 20, seed=2)
  play(first, 20, seed=1)
  second.load_state_dict(first.state_dict())
  play(second, 20, seed=2)
  assert torch.equal(whole.probabilities(), second.probabilities())
  assert not torch.equal(whole.probabilities(), first.probabilities())


@pytest.mark.parametrize("has_ends", [False, True])
def test_a_manual_reset_changes_no_counts_and_its_ends_count_in_the_next_step(has_ends: bool) -> None:
  without, with_reset = sampler(), sampler()
  clip, frame = torch.tensor([0, 1, 2, 2]), torch.tensor([10, 5, 20, 90])
  ended, none = torch.tensor([True, False, True, False]), torch.zeros(4, dtype=torch.bool)
  for books in (without, with_reset):
    play(books, 20)
    if has_ends:
      books.count_ends(clip, frame, ended, torch.tensor([True, False, False, False]))
  with_reset.count_step(clip, frame, none)
  if has_ends:
    for books in (without, with_reset):
      books.count_step(clip, frame, ~ended)
  assert all(torch.equal(value, with_reset.state_dict()[name]) for name, value in without.state_dict().items())


def test_the_log_has_each_clip_and_each_second_of_it() -> None:
  books = sampler()
  books.library.clip_names = ("a", "b", "c")
  play(books, 200)
  log = books.log()
  assert log["c/success"] < log["a/success"]
  p = books.probabilities()
  assert log["a/start_share"] == pytest.approx(p[:3].sum().item())
  assert [log[f"a/start_share_{second:03d}s"].item() for second in range(3)] == p[:3].tolist()
  assert 0.0 < log["sampling_entropy"] <= 1.0


@pytest.mark.parametrize("change", [{"uniform_share": 0.0}, {"memory": 2.0}, {"prior": 0.0}, {"lookahead": 0}])
def test_impossible_settings_are_named(change: dict[str, Any]) -> None:
  (name,) = change
  (problem,) = field_problems(AdaptiveSamplingCfg(**change))
  assert problem.startswith(f"{name} must be")
