"""Rays of both engines against MuJoCo's."""

from typing import Any

import pytest
import torch
from mjlab_core import MjlabError
from mjlab_sim import Simulation
from sim_world import NUM_WORLDS, MakeSim


def test_a_miss_is_minus_one_without_a_normal(sim: Simulation) -> None:
  caster = sim.make_ray_caster(2)
  up = torch.tensor([0.0, 0.0, 1.0], dtype=sim.dtype).expand(NUM_WORLDS, 2, 3)
  start = torch.tensor([0.0, 0.0, 3.0], dtype=sim.dtype).expand(NUM_WORLDS, 2, 3)
  for _ in range(2):
    hits = caster.cast(start, up)
    assert (hits.distance == -1).all()
    assert hits.geomid is not None
    assert hits.geomid.eq(-1).all()
    assert not hits.normal.any()
    assert (caster.cast(start, -up).distance > 0).all()


def test_outputs_of_a_caster_stay_in_its_memory(sim: Simulation) -> None:
  caster = sim.make_ray_caster(1)
  down = torch.tensor([0.0, 0.0, -1.0], dtype=sim.dtype).expand(NUM_WORLDS, 1, 3)
  first, second = (caster.cast(sim.data.xpos[:, 1:2] + height, down).distance for height in (1.0, 2.0))
  assert second.data_ptr() == first.data_ptr()
  assert (second > 1.8).all()


@pytest.mark.parametrize(
  ("num_rays", "options", "message"),
  [
    (0, {}, "num_rays must be at least 1"),
    (1, {"geomgroup": (True, False)}, "geomgroup must have 6 elements, got"),
    (1, {"bodyexclude": 99}, r"bodyexclude must be in \[-1, "),
    (3, {"bodyexclude": (0, 1, 99)}, r"bodyexclude must be in \[-1, \d+\], got \(0, 1, 99\)"),
    (1, {"max_distance": 0.0}, "max_distance must be positive"),
  ],
)
def test_rays_that_do_not_fit_are_refused(
  make_sim: MakeSim, num_rays: int, options: dict[str, Any], message: str
) -> None:
  with pytest.raises(MjlabError, match=message):
    make_sim().make_ray_caster(num_rays, **options)


def test_casters_come_and_go(sim: Simulation) -> None:
  down = torch.tensor([0.0, 0.0, -1.0], dtype=sim.dtype).expand(NUM_WORLDS, 1, 3)
  for height in range(1, 20):
    start = torch.tensor([5.0, 5.0, height], dtype=sim.dtype).expand(NUM_WORLDS, 1, 3)
    # Gone before the next one is made, which may be at the same address.
    assert sim.make_ray_caster(1).cast(start, down).distance[:, 0].tolist() == [height] * NUM_WORLDS
