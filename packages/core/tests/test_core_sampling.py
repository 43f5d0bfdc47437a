"""Distributions against SciPy, masked writes, and seeds."""

import math
import random
from typing import Any

import mjlab_core as core
import numpy as np
import pytest
import torch
from scipy import stats

ROWS = 4000


def ks(sample: torch.Tensor, distribution: Any) -> float:
  return stats.kstest(sample.double().flatten().numpy(), distribution.cdf).pvalue


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_draws_follow_their_distribution(dtype: torch.dtype) -> None:
  rng = core.make_generator("cpu", 0)
  options: dict[str, Any] = {"generator": rng, "dtype": dtype}
  assert ks(core.uniform(-1.0, 3.0, (ROWS,), **options), stats.uniform(-1.0, 4.0)) > 0.01
  assert ks(core.log_uniform(0.1, 10.0, (ROWS,), **options), stats.loguniform(0.1, 10.0)) > 0.01
  assert ks(core.gaussian(2.0, 0.5, (ROWS,), **options), stats.norm(2.0, 0.5)) > 0.01
  cut = core.truncated_normal(2.0, 0.5, 1.5, 4.0, (ROWS,), **options)
  assert cut.dtype == dtype
  assert ks(cut, stats.truncnorm(-1.0, 4.0, 2.0, 0.5)) > 0.01


def test_bounds_may_differ_per_column_and_elements_are_independent() -> None:
  rng = core.make_generator("cpu", 0)
  lo, hi = torch.tensor([0.0, 10.0]), torch.tensor([1.0, 30.0])
  for sample in (
    core.uniform(lo, hi, (ROWS, 2), generator=rng),
    core.truncated_normal(hi, hi, lo, hi, (ROWS, 2), generator=rng),
  ):
    assert ((sample >= lo) & (sample <= hi)).all()
    assert len(sample[:, 0].unique()) > ROWS // 2
    assert abs(np.corrcoef(sample.numpy().T)[0, 1]) < 0.05
  assert core.gaussian(lo, hi, (ROWS, 2), generator=rng).std(0)[1] > 20.0


def test_a_distribution_of_no_width_is_its_point() -> None:
  assert (core.uniform(2.0, 2.0, (3,)) == 2.0).all()
  assert (core.gaussian(2.0, 0.0, (3,)) == 2.0).all()
  assert (core.truncated_normal(2.0, 0.0, 1.0, 3.0, (3,)) == 2.0).all()
  torch.testing.assert_close(core.log_uniform(2.0, 2.0, (3,)), torch.full((3,), 2.0))


@pytest.mark.parametrize(
  "src", [7.0, torch.tensor(7.0), torch.full((4, 1), 7.0), torch.full((4, 3), 7, dtype=torch.int32)]
)
def test_masked_writes_touch_masked_rows_only_and_stay_in_place(src: torch.Tensor | float) -> None:
  mask = torch.tensor([True, False, True, False])
  base = torch.rand(4, 3)
  dst = base.clone()
  version, address = dst._version, dst.data_ptr()
  assert core.where_(dst, mask, src) is dst
  assert dst._version > version
  assert dst.data_ptr() == address
  assert (dst[mask] == 7.0).all()
  assert torch.equal(dst[~mask], base[~mask])
  assert torch.equal(core.fill_(base, mask, 7.0), dst)


def test_masked_writes_reach_through_views_and_refuse_wrong_shapes() -> None:
  mask = torch.tensor([True, False])
  storage = torch.zeros(2, 6)
  core.where_(storage[:, 1::2], mask, torch.ones(2, 3))
  assert storage.tolist() == [[0.0, 1.0] * 3, [0.0] * 6]
  with pytest.raises(RuntimeError):
    core.where_(storage, mask, torch.ones(2, 5))


@pytest.mark.parametrize(
  ("mask", "given"),
  [(torch.tensor([0, 1]), r"torch\.int64 \(2,\)"), (torch.ones(2), "torch.float32"), ([True, False], "list")],
)
def test_world_numbers_as_a_mask_are_refused(mask: Any, given: str) -> None:
  for write in (core.where_, core.fill_):
    dst = torch.zeros(2)
    with pytest.raises(TypeError, match=f"`mask` must be a bool tensor .*, got {given}"):
      write(dst, mask, 1.0)
    assert not dst.any()


def test_nan_in_unmasked_rows_of_the_source_is_not_written() -> None:
  dst = torch.zeros(2)
  core.where_(dst, torch.tensor([False, True]), torch.tensor([math.nan, 1.0]))
  assert dst.tolist() == [0.0, 1.0]


def test_seeding_reaches_every_global_generator_and_says_the_seed() -> None:
  def draws() -> tuple[float, float, float]:
    return random.random(), float(np.random.rand()), float(torch.rand(()))  # noqa: NPY002

  assert core.seed_everything(5) == 5
  first = draws()
  core.seed_everything(5)
  assert draws() == first
  drawn = core.seed_everything()
  second = draws()
  assert core.seed_everything(drawn) == drawn
  assert draws() == second


def test_generators_repeat_with_their_seed_whatever_the_global_one_draws() -> None:
  a, b = core.make_generator("cpu", 3), core.make_generator("cpu", 3)
  torch.rand(3)
  assert torch.equal(torch.rand(4, generator=a), torch.rand(4, generator=b))


def test_later_draws_do_not_depend_on_a_call_that_an_empty_mask_skips() -> None:
  outside, inside = [], []

  def act(mask: torch.Tensor) -> None:
    inside.append(torch.rand(3, generator=rng))
    core.call_where(mask[:1], lambda _: torch.rand(5, generator=rng), rng)
    torch.randn(len(inside), generator=rng)

  for worlds in ([], [0, 1], [1], []):
    rng = core.make_generator("cpu", 3)
    mask = torch.zeros(2, dtype=torch.bool)
    mask[worlds] = True
    core.call_where(mask, act, rng)
    outside.append(torch.randn(3, generator=rng))
  assert len(inside) == 2
  assert torch.equal(*inside)
  assert all(torch.equal(outside[0], other) for other in outside)
  # The stream of the call is another one, and the next call has its own again.
  core.call_where(~mask, act, rng)
  rng.manual_seed(3)
  assert len({tuple(draw.tolist()) for draw in (*inside[1:], torch.rand(3, generator=rng))}) == 3
