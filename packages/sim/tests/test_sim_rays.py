"""Rays of both engines against MuJoCo's."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from mjlab_core import MjlabError
from mjlab_sim import Simulation
from sim_rays import mujoco_rays
from sim_world import NUM_WORLDS, scatter

MakeSim = Callable[..., Simulation]

NUM_RAYS = 80


def random_rays(sim: Simulation) -> tuple[torch.Tensor, torch.Tensor]:
  """From a shell around the scene to points inside of it, so that most rays hit something."""
  rng = np.random.default_rng(5)
  shape = (NUM_WORLDS, NUM_RAYS, 3)
  origin = rng.uniform([-3.0, -2.0, 1.5], [2.0, 2.0, 2.5], shape)
  toward = rng.normal(0.0, 0.15, shape)
  geoms = sim.data.geom_xpos.double().numpy()
  toward += geoms[:, rng.integers(1, geoms.shape[1], NUM_RAYS)]
  direction = toward - origin
  direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
  return torch.tensor(origin, dtype=sim.dtype), torch.tensor(direction, dtype=sim.dtype)


@pytest.mark.parametrize(
  "group", [None, (True, False, False, False, False, False), (False, True, True, False, True, True)]
)
def test_rays_hit_what_mujocos_rays_hit(make_sim: MakeSim, engine: str, group: tuple[bool, ...] | None) -> None:
  sim = make_sim(engine)
  scatter(sim)
  origins, directions = random_rays(sim)
  block = sim.mj_model.body("block").id
  hits = sim.make_ray_caster(NUM_RAYS, geomgroup=group, bodyexclude=block).cast(origins, directions)
  assert hits.geomid is not None
  mask = None if group is None else np.array(group, dtype=np.uint8)
  distance, geom, normal = mujoco_rays(sim, origins, directions, group=mask, exclude=block)
  found = hits.normal.double().numpy()
  along = np.abs([np.einsum("ijk,ijk->ij", normals, directions.double().numpy()) for normals in (found, normal)])
  same = hits.geomid.numpy() == geom
  # Only a ray that grazes a surface may be of two minds in float32.
  assert same.all() or engine == "warp"
  assert (along.min(axis=0)[~same] < 0.02).all()
  np.testing.assert_allclose(hits.distance.double().numpy()[same], distance[same], rtol=1e-4, atol=1e-4)
  steep = same & (along[1] > 0.1)
  np.testing.assert_allclose(found[steep], normal[steep], atol=2e-3)
  seen = set(geom[same].tolist())
  names = {sim.mj_model.geom(geom).name for geom in seen if geom >= 0}
  if group is None:
    assert names >= {"floor", "ball", "rod", "upper", "post", "egg", "crate"}
    assert "block" not in names
  elif group[0]:
    assert not names & {"post", "egg", "crate"}
  else:
    assert names == {"post", "egg"}
    assert -1 in seen


def test_a_miss_is_minus_one_without_a_normal(make_sim: MakeSim, engine: str) -> None:
  sim = make_sim(engine)
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


def test_outputs_of_a_caster_stay_in_its_memory(make_sim: MakeSim, engine: str) -> None:
  sim = make_sim(engine)
  origins, directions = random_rays(sim)
  caster = sim.make_ray_caster(NUM_RAYS)
  first = caster.cast(origins, directions)
  kept = first.distance.clone()
  second = caster.cast(origins + 0.1, directions)
  assert second.distance.data_ptr() == first.distance.data_ptr()
  assert not torch.equal(second.distance, kept)


def test_rays_that_do_not_fit_are_refused(make_sim: MakeSim, engine: str) -> None:
  sim = make_sim(engine)
  with pytest.raises(MjlabError, match="num_rays must be at least 1"):
    sim.make_ray_caster(0)
  with pytest.raises(MjlabError, match="geomgroup must have 6 elements, got"):
    sim.make_ray_caster(1, geomgroup=(True, False))
  with pytest.raises(MjlabError, match=r"bodyexclude must be in \[-1, "):
    sim.make_ray_caster(1, bodyexclude=99)


def test_casters_come_and_go(make_sim: MakeSim, engine: str) -> None:
  sim = make_sim(engine)
  down = torch.tensor([0.0, 0.0, -1.0], dtype=sim.dtype).expand(NUM_WORLDS, 1, 3)
  for height in range(1, 20):
    start = torch.tensor([5.0, 5.0, height], dtype=sim.dtype).expand(NUM_WORLDS, 1, 3)
    # Gone before the next one is made, which may be at the same address.
    assert sim.make_ray_caster(1).cast(start, down).distance[:, 0].tolist() == [height] * NUM_WORLDS
