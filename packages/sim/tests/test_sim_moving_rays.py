"""Rays among moving geoms of every type, and through the tree of a body."""

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
import pytest
import torch
from mjlab_sim import RayHits, Simulation, SimulationCfg
from sim_rays import Expected, check, mujoco_rays

NUM_ENVS, NUM_RAYS = 3, 150
Geom = mujoco.mjtGeom
FREE, CARRIED = ("box", "mesh"), ("sphere", "capsule", "ellipsoid", "cylinder")
MOVING = FREE + CARRIED


def tumbling() -> mujoco.MjSpec:
  """A body that floats or is carried for each type of geom, a robot around which rays start, and a field on a lift."""
  spec = mujoco.MjSpec()
  spec.worldbody.add_geom(name="plane", type=Geom.mjGEOM_PLANE, size=[0, 0, 1], pos=[0, 0, -1])
  rng = np.random.default_rng(0)
  star = [(0, 0, 1), (1, 0.2, 0), (0.3, 0.3, 0), (0, 1, 0), (-1, -0.5, 0), (0, 0, -0.4)]
  faces = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1), (5, 2, 1), (5, 3, 2), (5, 4, 3), (5, 1, 4)]
  for name, scale in (("star", 0.5), ("big star", 0.9)):
    spec.add_mesh(name=name, uservert=scale * np.ravel(star), userface=np.ravel(faces))
  for name in MOVING:
    body = spec.worldbody.add_body(name=name, mocap=name in CARRIED)
    if name in FREE:
      body.add_freejoint()
    geom = body.add_geom(name=name, type=getattr(Geom, f"mjGEOM_{name.upper()}"))
    if name == "mesh":
      geom.meshname = "star"
    else:
      geom.size = [0.3, 0.2, 0.15]
  lift = spec.worldbody.add_body(name="lift", mocap=True, pos=[0, 0, -0.9])
  spec.add_hfield(name="field", nrow=4, ncol=5, size=[1.5, 1.5, 0.5, 0.1], userdata=rng.uniform(size=20))
  lift.add_geom(name="hfield", type=Geom.mjGEOM_HFIELD, hfieldname="field")
  trunk = spec.worldbody.add_body(name="trunk")
  trunk.add_freejoint()
  trunk.add_geom(name="trunk", type=Geom.mjGEOM_BOX, size=[0.4, 0.3, 0.2])
  for side in (-1, 1):
    leg = trunk.add_body(name=f"leg{side}", pos=[0.2, 0.2 * side, 0])
    leg.add_joint(axis=[0, 1, 0])
    leg.add_geom(name=f"leg{side}", type=Geom.mjGEOM_CAPSULE, size=[0.1, 0, 0], fromto=[0, 0, 0, 0, 0, -0.7])
  for geom in spec.geoms:
    geom.contype = geom.conaffinity = 0
  return spec


@pytest.fixture(scope="module", params=["native", pytest.param("warp", marks=pytest.mark.warp)])
def sim(request: pytest.FixtureRequest) -> Simulation:
  sim = Simulation(NUM_ENVS, tumbling(), SimulationCfg(engine=request.param, num_threads=1))
  rng = np.random.default_rng(1)
  places = torch.tensor(rng.uniform(-1.5, 1.5, (NUM_ENVS, len(MOVING) + 1, 3)), dtype=sim.dtype)
  turns = torch.tensor(rng.normal(size=(NUM_ENVS, len(MOVING) + 1, 4)), dtype=sim.dtype)
  turns /= turns.norm(dim=-1, keepdim=True)
  places[:, len(FREE)] = 0.0  # The robot.
  free = len(FREE) + 1
  sim.data.qpos[:, : 7 * free] = torch.cat((places, turns), dim=-1)[:, :free].flatten(1)
  sim.data.mocap_pos[:, :-1], sim.data.mocap_quat[:, :-1] = places[:, free:], turns[:, free:]
  sim.data.mocap_pos[:, -1, 2] += torch.tensor([0.0, 0.1, 0.2], dtype=sim.dtype)
  return sim


def rays(sim: Simulation) -> tuple[torch.Tensor, torch.Tensor]:
  """From within the robot towards all geoms, and past them."""
  rng = np.random.default_rng(2)
  origins = rng.uniform(-0.3, 0.3, (NUM_ENVS, NUM_RAYS, 3))
  geoms = sim.data.geom_xpos.double().numpy()
  directions = geoms[:, rng.integers(1, geoms.shape[1], NUM_RAYS)] + rng.normal(0.0, 0.15, origins.shape) - origins
  directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
  return torch.tensor(origins, dtype=sim.dtype), torch.tensor(directions, dtype=sim.dtype)


def expected_of(sim: Simulation, models: Sequence[mujoco.MjModel]) -> Expected:
  return mujoco_rays(sim, *rays(sim), models=models)


def same(hits: RayHits, expected: Expected, far: float = np.inf) -> None:
  check(hits, expected, far=far, atol=3e-5, normals=5e-4)


def without(model: mujoco.MjModel, *bodies: str) -> mujoco.MjModel:
  """The model with the geoms of these bodies invisible, which rays pass through."""
  model = copy.copy(model)
  model.geom_rgba[np.isin(model.geom_bodyid, [model.body(body).id for body in bodies]), 3] = 0.0
  return model


def test_rays_see_every_type_of_geom_where_it_is(sim: Simulation) -> None:
  expected = expected_of(sim, [without(sim.mj_model, "trunk", "leg-1", "leg1")] * NUM_ENVS)
  trunk = sim.mj_model.body("trunk").id
  hits = sim.make_ray_caster(NUM_RAYS, bodyexclude=trunk, exclude_trees=True).cast(*rays(sim))
  same(hits, expected)
  seen = {sim.mj_model.geom(geom).name for geom in np.unique(expected[1]) if geom >= 0}
  assert seen == {*MOVING, "plane", "hfield"}


def test_rays_pass_through_the_tree_of_a_body_or_through_that_body_alone(sim: Simulation) -> None:
  model = sim.mj_model
  leg = model.body("leg1").id
  alone = sim.make_ray_caster(NUM_RAYS, bodyexclude=leg)
  same(alone.cast(*rays(sim)), expected_of(sim, [without(model, "leg1")] * NUM_ENVS))
  # Rays of a robot and rays of others go together.
  half = NUM_RAYS // 2
  mixed = sim.make_ray_caster(NUM_RAYS, bodyexclude=[leg] * half + [-1] * half, exclude_trees=True)
  hits = mixed.cast(*rays(sim))
  past, all_of_it = (expected_of(sim, [seen] * NUM_ENVS) for seen in (without(model, "trunk", "leg-1", "leg1"), model))
  same(hits, tuple(np.concatenate((a[:, :half], b[:, half:]), axis=1) for a, b in zip(past, all_of_it, strict=True)))


def test_a_ray_passes_through_all_geoms_of_its_robot(sim: Simulation) -> None:
  trunk = sim.mj_model.body("trunk").id
  caster = sim.make_ray_caster(NUM_RAYS, bodyexclude=trunk, exclude_trees=True, max_distance=0.8)
  hits = caster.cast(*rays(sim))
  expected = expected_of(sim, [without(sim.mj_model, "trunk", "leg-1", "leg1")] * NUM_ENVS)
  same(hits, expected, far=0.8)
  assert (expected[0] > 0.8).any()


def test_rays_without_geoms_hit_the_same(sim: Simulation) -> None:
  leg = sim.mj_model.body("leg1").id
  for max_distance in (np.inf, 0.8):
    hits = [
      sim.make_ray_caster(NUM_RAYS, bodyexclude=leg, exclude_trees=True, geomid=geomid, max_distance=max_distance).cast(
        *rays(sim)
      )
      for geomid in (True, False)
    ]
    torch.testing.assert_close(hits[1].distance, hits[0].distance, rtol=0, atol=1e-6)
    torch.testing.assert_close(hits[1].normal, hits[0].normal, rtol=0, atol=1e-5)


def test_rays_see_another_mesh_in_one_world(sim: Simulation) -> None:
  model = without(sim.mj_model, "trunk", "leg-1", "leg1")
  geom, big = model.geom("mesh").id, model.mesh("big star").id
  caster = sim.make_ray_caster(NUM_RAYS, bodyexclude=model.body("trunk").id, exclude_trees=True)
  sim.expand_model_fields(["geom_dataid"])
  sim.model.geom_dataid[1, geom] = big
  changed = copy.copy(model)
  changed.geom_dataid[geom] = big
  expected = expected_of(sim, [model, changed, model])
  same(caster.cast(*rays(sim)), expected)
  before = expected_of(sim, [model] * NUM_ENVS)
  assert (expected[0] != before[0]).any(axis=1).tolist() == [False, True, False]
