"""Windows and delays: against a plain list per world, with random resets, and row by row."""

from typing import Any

import pytest
import torch
from mjlab_core import DelayBuffer, HistoryBuffer, make_generator

N = 5


def frame(step: int, shape: tuple[int, ...] = (2,)) -> torch.Tensor:
  """A frame that says its step and world: step + world / 100."""
  base = step + torch.arange(N).reshape(N, *[1] * len(shape)) / 100
  return base.expand(N, *shape).clone()


def masks(steps: int, seed: int = 0) -> torch.Tensor:
  return torch.rand(steps, N, generator=make_generator("cpu", seed)) < 0.2


@pytest.mark.parametrize("length", [1, 2, N, 7])
@pytest.mark.parametrize("shape", [(), (2,), (2, 3)])
def test_history_equals_a_list_per_world_under_random_resets(length: int, shape: tuple[int, ...]) -> None:
  history, rows = HistoryBuffer(length, N, shape, "cpu"), [[] for _ in range(N)]
  for step, mask in enumerate(masks(40)):
    history.reset(mask)
    history.append(frame(step, shape))
    for world, value in enumerate(frame(step, shape)):
      rows[world] = [*([] if mask[world] else rows[world]), value]
    window = history.read()
    assert window.shape == (N, length, *shape)
    assert torch.equal(window, torch.stack([torch.stack(([row[0]] * length + row)[-length:]) for row in rows]))


def test_a_reset_row_reads_zero_until_its_next_frame() -> None:
  history = HistoryBuffer(3, N, (2,), "cpu")
  assert (history.read() == 0.0).all()
  history.append(frame(1))
  history.reset(torch.arange(N) == 2)
  assert (history.read()[2] == 0.0).all()
  assert (history.read()[1] == frame(1)[1]).all()


def test_fill_replaces_the_whole_window_of_masked_rows_only() -> None:
  history = HistoryBuffer(3, N, (2,), "cpu")
  for step in range(4):
    history.append(frame(step))
  before = history.read()
  mask = torch.arange(N) % 2 == 0
  history.fill(mask, frame(9))
  after = history.read()
  assert torch.equal(after[~mask], before[~mask])
  assert torch.equal(after[mask], frame(9)[mask][:, None].expand(-1, 3, -1))
  history.append(frame(10))
  assert torch.equal(history.read()[0, :, 0], torch.tensor([9.0, 9.0, 10.0]))


def test_memory_stays_where_it_is_and_reads_do_not_alias() -> None:
  history = HistoryBuffer(3, N, (2,), "cpu")
  addresses = {name: t.data_ptr() for name, t in vars(history).items() if isinstance(t, torch.Tensor)}
  first = history.read()
  history.append(frame(5))
  history.reset(torch.ones(N, dtype=torch.bool))
  history.fill(torch.ones(N, dtype=torch.bool), 3.0)
  assert {name: t.data_ptr() for name, t in vars(history).items() if isinstance(t, torch.Tensor)} == addresses
  assert (first == 0.0).all()


def delay(min_lag: int, max_lag: int, *, seed: int = 0, **options: Any) -> DelayBuffer:
  return DelayBuffer(min_lag, max_lag, N, (2,), "cpu", torch.float32, make_generator("cpu", seed), **options)


@pytest.mark.parametrize("lag", [0, 1, 3])
def test_a_constant_lag_serves_the_frame_that_old_and_draws_nothing(lag: int) -> None:
  rng = make_generator("cpu", 0)
  buffer = DelayBuffer(lag, lag, N, (2,), "cpu", torch.float32, rng, hold_prob=0.5, update_period=3)
  untouched = rng.get_state()
  for step in range(10):
    assert torch.equal(buffer.push(frame(step)), frame(max(step - lag, 0)))
  buffer.reset(torch.ones(N, dtype=torch.bool))
  assert torch.equal(rng.get_state(), untouched)


@pytest.mark.parametrize("hold_prob", [0.0, 0.9, 1.0])
@pytest.mark.parametrize("update_period", [0, 1, 10])
@pytest.mark.parametrize(("min_lag", "max_lag"), [(0, 2), (2, 3), (3, 3)])
def test_a_lag_is_never_outside_its_bounds_nor_a_frame_younger(
  min_lag: int, max_lag: int, update_period: int, hold_prob: float
) -> None:
  buffer = delay(min_lag, max_lag, hold_prob=hold_prob, update_period=update_period)
  born = torch.zeros(N)
  worlds = torch.arange(N) / 100
  for step, mask in enumerate(masks(60)):
    buffer.reset(mask)
    born = torch.where(mask, step, born)
    served = buffer.push(frame(step))[:, 0] - worlds
    assert ((buffer.lag >= min_lag) & (buffer.lag <= max_lag)).all()
    expected = torch.maximum(step - buffer.lag, born)
    torch.testing.assert_close(served, expected, atol=1e-4, rtol=0.0)


def test_all_lags_occur_equally_often() -> None:
  buffer = delay(1, 3)
  counts = torch.zeros(4)
  for step in range(600):
    buffer.push(frame(step))
    counts += torch.bincount(buffer.lag, minlength=4)
  assert counts[0] == 0
  torch.testing.assert_close(counts[1:] / counts.sum(), torch.full((3,), 1 / 3), atol=0.04, rtol=0.0)


def test_lags_change_only_every_update_period_and_hold_keeps_them() -> None:
  buffer = delay(0, 50, update_period=4)
  changes = torch.zeros(20, N, dtype=torch.bool)
  for step in range(20):
    before = buffer.lag.clone()
    buffer.push(frame(step))
    changes[step] = buffer.lag != before
  for world in range(N):
    steps = changes[:, world].nonzero().flatten()
    assert len(steps) >= 4
    assert len(set((steps % 4).tolist())) == 1
  held = delay(0, 50, hold_prob=1.0)
  lag = held.lag.clone()
  held.push(frame(0))
  assert torch.equal(held.lag, lag)


@pytest.mark.parametrize(("per_env_phase", "phases"), [(True, {0, 1, 2, 3}), (False, {4})])
def test_worlds_redraw_in_separate_phases_or_after_a_whole_period(per_env_phase: bool, phases: set[int]) -> None:
  worlds = 64
  generator = make_generator("cpu", 0)
  buffer = DelayBuffer(
    0, 10_000, worlds, (1,), "cpu", generator=generator, update_period=4, per_env_phase=per_env_phase
  )
  first = torch.full((worlds,), -1)
  for step in range(5):
    before = buffer.lag.clone()
    buffer.push(torch.zeros(worlds, 1))
    first[(buffer.lag != before) & (first < 0)] = step
  assert set(first.tolist()) == phases


def test_after_fill_the_filled_value_is_served_for_the_whole_lag() -> None:
  buffer = delay(3, 3)
  everyone = torch.ones(N, dtype=torch.bool)
  buffer.push(frame(0))
  buffer.fill(everyone, frame(7))
  for step in (8, 9, 10):
    assert torch.equal(buffer.push(frame(step)), frame(7))
  assert torch.equal(buffer.push(frame(11)), frame(8))


def test_a_shared_lag_is_one_for_all_worlds_and_survives_resets() -> None:
  buffer = delay(0, 9, per_env=False, update_period=3)
  for step in range(12):
    lag = buffer.lag.clone()
    buffer.reset(torch.arange(N) == step % N)
    assert torch.equal(buffer.lag, lag)
    buffer.push(frame(step))
    assert (buffer.lag == buffer.lag[0]).all()


@pytest.mark.parametrize("verb", ["reset", "fill"])
def test_rows_outside_the_mask_stay_bit_identical(verb: str) -> None:
  def rollout(resets: bool) -> list[torch.Tensor]:
    buffer = delay(0, 3, hold_prob=0.3, update_period=2)
    history = HistoryBuffer(3, N, (2,), "cpu")
    out = []
    for step in range(20):
      mask = torch.zeros(N, dtype=torch.bool)
      mask[1] = resets and step % 4 == 0
      for item in (buffer, history):
        item.fill(mask, 5.0) if verb == "fill" else item.reset(mask)
      x = frame(step)
      history.append(x)
      out.append(torch.cat((buffer.push(x)[:, None], history.read()), 1))
    return out

  others = torch.arange(N) != 1
  # Both rollouts reset at the same steps, so both draw the same numbers: only the mask differs.
  for a, b in zip(rollout(True), rollout(False), strict=True):
    assert torch.equal(a[others], b[others])


@pytest.mark.parametrize("verb", ["reset", "fill"])
def test_a_restart_draws_the_lags_of_its_worlds_and_of_no_others(verb: str) -> None:
  buffer = delay(0, 10_000, hold_prob=1.0)
  mask, before = torch.arange(N) % 2 == 0, buffer.lag.clone()
  buffer.reset(mask) if verb == "reset" else buffer.fill(mask, 0.0)
  assert torch.equal(buffer.lag != before, mask)


def test_a_saved_delay_continues_bit_identically() -> None:
  a, b = delay(0, 3, hold_prob=1.0), delay(0, 3, seed=1, hold_prob=1.0)
  for step in range(5):
    a.push(frame(step))
  b.load_state_dict(a.state_dict())
  for step in range(5, 10):
    assert torch.equal(a.push(frame(step)), b.push(frame(step)))


def test_bad_settings_are_refused() -> None:
  for make, message in (
    (lambda: delay(3, 2), r"\(min_lag, max_lag\) must not fall, got \(3, 2\)"),
    (lambda: delay(0, 2, hold_prob=1.5), "hold_prob"),
    (lambda: HistoryBuffer(0, N, (), "cpu"), "length must be at least 1"),
  ):
    with pytest.raises(ValueError, match=message):
      make()


def test_frames_are_cast_to_the_type_of_the_buffer() -> None:
  buffer = delay(1, 1)
  assert buffer.push(frame(0).double()).dtype == torch.float32


@pytest.mark.parametrize("options", [{}, {"hold_prob": 0.5}, {"update_period": 2}, {"hold_prob": 1.0}])
def test_pinned_lags_stay_through_draws_and_resets_and_others_are_drawn_as_before(options: dict[str, Any]) -> None:
  buffer, twin = delay(1, 4, **options), delay(1, 4, **options)
  none, every = torch.zeros(N, dtype=torch.bool), torch.ones(N, dtype=torch.bool)
  mask = torch.arange(N) < 2
  buffer.pin(none, 3)
  wanted = torch.where(mask, torch.arange(N) + 2, 9)
  for step in range(12):
    if step == 3:
      buffer.pin(mask, wanted)
    served = buffer.push(frame(step))
    freely = twin.push(frame(step))
    assert torch.equal(served[~mask], freely[~mask])
    assert torch.equal(buffer.lag[~mask], twin.lag[~mask])
    if step >= 3:
      assert buffer.lag[mask].tolist() == [2, 3]
    if step == 6:
      buffer.reset(every)
      twin.reset(every)
  assert len(set(twin.lag.tolist())) > 1 or options == {"hold_prob": 1.0}
  # A lag outside of the bounds is the nearest within, and a pin replaces the one before.
  buffer.pin(every, torch.tensor([0, 9, 1, 4, 2]))
  buffer.push(frame(12))
  assert buffer.lag.tolist() == [1, 4, 1, 4, 2]
  copy = delay(1, 4, seed=5, **options)
  copy.pin(none, 1)
  copy.load_state_dict(buffer.state_dict())
  assert torch.equal(copy.push(frame(13)), buffer.push(frame(13)))
