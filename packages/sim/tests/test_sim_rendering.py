"""Images of every world in fixed memory, drawn in the worlds of a mask."""

from typing import Any

import pytest
import torch
from mjlab_core import MjlabError
from mjlab_sim import Simulation
from sim_world import MakeSim, scatter

ALL: Any = ("rgb", "depth", "distance", "segmentation")


def clones(images: Any) -> list[torch.Tensor]:
  return [value.clone() for value in vars(images).values() if value is not None]


@pytest.mark.warp
def test_worlds_outside_the_mask_keep_their_images(sim: Simulation) -> None:
  scatter(sim)
  renderer, reference = (sim.make_renderer(0, 6, 4, ALL) for _ in range(2))
  black = clones(renderer.images)
  assert [value.unique().tolist() for value in black] == [[0], [-1], [-1], [-1]]
  mask = torch.arange(sim.num_envs) % 2 == 0
  now = clones(reference.render())
  for drawn, before, expected in zip(clones(renderer.render(mask)), black, now, strict=True):
    assert torch.equal(drawn[mask], expected[mask])
    assert torch.equal(drawn[~mask], before[~mask])
  for drawn, expected in zip(clones(renderer.render()), now, strict=True):
    assert torch.equal(drawn, expected)
  sim.data.qpos[:, 2] += 0.3
  later = clones(reference.render())
  for drawn, before, expected in zip(clones(renderer.render(~mask)), now, later, strict=True):
    assert torch.equal(drawn[~mask], expected[~mask])
    assert torch.equal(drawn[mask], before[mask])


@pytest.mark.warp
def test_both_engines_draw_the_same(make_sim: MakeSim) -> None:
  images: list[Any] = []
  for engine in ("native", "warp"):
    sim = make_sim(engine)
    scatter(sim)
    images.append(sim.make_renderer(0, 12, 8, ALL).render())
  native, warp = images
  assert torch.equal(native.segmentation, warp.segmentation)
  torch.testing.assert_close(native.depth, warp.depth, rtol=1e-5, atol=1e-5)
  assert (native.rgb.int() - warp.rgb.int()).abs().max() <= 1


@pytest.mark.parametrize(
  ("arguments", "message"),
  [
    ((1, 6, 4), "renderer: camera must be at most 0, got 1"),
    ((-1, 6, 4), "renderer: camera must not be negative, got -1"),
    ((0, 0, 4), "renderer: width must be at least 1, got 0"),
    ((0, 6, 4, ("deph",)), "renderer: data_types 'deph' does not exist. Nearest: depth"),
  ],
)
def test_a_view_that_does_not_fit_is_refused(make_sim: MakeSim, arguments: Any, message: str) -> None:
  with pytest.raises(MjlabError, match=message):
    make_sim("native").make_renderer(*arguments)


@pytest.mark.warp
def test_wrong_masks_and_closed_simulations_are_refused(make_sim: MakeSim) -> None:
  sim = make_sim("native")
  renderer = sim.make_renderer(0, 6, 4)
  with pytest.raises(MjlabError, match="render: mask must be bool"):
    renderer.render(torch.zeros(sim.num_envs))
  sim.close()
  with pytest.raises(MjlabError, match="closed"):
    renderer.render()
