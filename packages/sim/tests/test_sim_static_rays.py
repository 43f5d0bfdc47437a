"""Rays on fixed ground in a tree: the same hits as MuJoCo's search of every geom."""

import copy
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_sim import Simulation, SimulationCfg
from mjlab_sim.rays import fixed_geoms, triangulate
from sim_rays import check, mujoco_rays

NUM_ENVS, NUM_RAYS = 3, 150
Geom = mujoco.mjtGeom

ENGINES = ["native", pytest.param("warp", marks=pytest.mark.warp)]


def rough_ground(seed: int = 0) -> mujoco.MjSpec:
  """Boxes every way up, height fields and a concave mesh on a tilted body; analytic geoms; a ball that falls."""
  rng = np.random.default_rng(seed)
  spec = mujoco.MjSpec()
  spec.worldbody.add_geom(name="floor", type=Geom.mjGEOM_PLANE, size=[0, 0, 1], pos=[0, 0, -1.5])
  terrain = spec.worldbody.add_body(name="terrain", pos=[0.2, -0.1, 0.1], quat=[0.99, 0.05, -0.08, 0.1])
  for k in range(36):
    place = [k % 6 - 2.5, k // 6 - 2.5, rng.uniform(-0.2, 0.2)]
    quat, size = rng.normal((2, 0, 0, 0), 1.0), rng.uniform(0.1, 0.5, 3)
    terrain.add_geom(name=f"box{k}", type=Geom.mjGEOM_BOX, size=size, pos=place, quat=quat)
  for k, (rows, columns) in enumerate(((3, 5), (6, 4))):
    heights = rng.uniform(size=(rows, columns))
    spec.add_hfield(name=f"field{k}", nrow=rows, ncol=columns, size=[1.5, 1, 0.8, 0.3], userdata=heights.ravel())
    quat = rng.normal((3, 0, 0, 0), 1.0)
    terrain.add_geom(
      name=f"field{k}", type=Geom.mjGEOM_HFIELD, hfieldname=f"field{k}", pos=[4 * k - 2, 0, 0.5], quat=quat
    )
  cross = [(0, 0, 1), (1, 0.2, 0), (0.3, 0.3, 0), (0, 1, 0), (-1, -0.5, 0), (0, 0, -0.4)]
  faces = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1), (5, 2, 1), (5, 3, 2), (5, 4, 3), (5, 1, 4)]
  spec.add_mesh(name="rock", uservert=np.ravel(cross), userface=np.ravel(faces))
  terrain.add_geom(name="rock", type=Geom.mjGEOM_MESH, meshname="rock", pos=[0, 2, 0.6], quat=[0.8, 0.3, 0.1, 0.2])
  terrain.add_geom(name="pole", type=Geom.mjGEOM_CAPSULE, size=[0.2, 0.5, 0], pos=[0, -2, 0.6])
  terrain.add_geom(name="ghost", type=Geom.mjGEOM_BOX, size=[5, 5, 0.1], pos=[0, 0, 1.3], rgba=[1, 1, 1, 0])
  spec.add_material(name="glass", rgba=[1, 1, 1, 0])
  terrain.add_geom(name="pane", type=Geom.mjGEOM_BOX, size=[5, 5, 0.1], pos=[0, 0, 1.3], material="glass")
  terrain.add_geom(name="canopy", type=Geom.mjGEOM_BOX, size=[1, 1, 0.1], pos=[0, 0, 1.3], group=2)
  ball = spec.worldbody.add_body(name="ball", pos=[0, 0, 2])
  ball.add_freejoint()
  ball.add_geom(name="ball", size=[0.4, 0, 0], mass=1)
  # Collisions with meshes and fields would take long to compile.
  for geom in spec.geoms:
    geom.contype = geom.conaffinity = 0
  return spec


def build(spec: mujoco.MjSpec, engine: Any) -> Simulation:
  return Simulation(NUM_ENVS, spec, SimulationCfg(engine=engine, num_threads=1))


def random_rays(sim: Simulation, seed: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
  """Half from above, half from among and inside the geoms."""
  rng = np.random.default_rng(seed)
  origins = rng.uniform([-3, -3, 1.5], [3, 3, 3], (NUM_ENVS, NUM_RAYS, 3))
  origins[:, ::2, 2] -= 1.8
  directions = rng.uniform([-3, -3, -0.5], [3, 3, 0.5], origins.shape) - origins
  directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
  return torch.tensor(origins, dtype=sim.dtype), torch.tensor(directions, dtype=sim.dtype)


@pytest.fixture(scope="module", params=ENGINES)
def sim(request: pytest.FixtureRequest) -> Simulation:
  sim = build(rough_ground(), request.param)
  sim.data.qpos[:, :2] += torch.tensor([[0.0, 0.0], [1.0, 1.0], [-2.0, 1.0]], dtype=sim.dtype)
  return sim


@pytest.mark.parametrize("geomid", [True, False])
@pytest.mark.parametrize("group", [None, (True, False, False, False, False, False), (False, False, True) * 2])
def test_rays_see_the_ground_as_mujoco_does(sim: Simulation, geomid: bool, group: Any) -> None:
  origins, directions = random_rays(sim)
  caster = sim.make_ray_caster(NUM_RAYS, geomgroup=group, geomid=geomid)
  hits = caster.cast(origins, directions)
  mask = None if group is None else np.array(group, dtype=np.uint8)
  expected = mujoco_rays(sim, origins, directions, group=mask)
  check(hits, expected)
  assert (hits.geomid is not None) == geomid
  seen = {sim.mj_model.geom(geom).name for geom in np.unique(expected[1]) if geom >= 0}
  assert not seen & {"ghost", "pane"}
  if group is None:
    assert seen >= {"canopy", "ball", "rock", "pole", "floor", "field0", "field1", "box0"}


def test_each_ray_may_exclude_another_body(sim: Simulation) -> None:
  origins, directions = random_rays(sim, seed=2)
  exclude = np.tile([-1, sim.mj_model.body("ball").id, sim.mj_model.body("terrain").id], NUM_RAYS // 3)
  hits = sim.make_ray_caster(NUM_RAYS, bodyexclude=exclude.tolist()).cast(origins, directions)
  check(hits, mujoco_rays(sim, origins, directions, exclude=exclude))


def test_hits_that_are_too_far_are_misses(sim: Simulation) -> None:
  origins, directions = random_rays(sim, seed=3)
  expected = mujoco_rays(sim, origins, directions)
  for geomid in (True, False):
    hits = sim.make_ray_caster(NUM_RAYS, max_distance=1.2, geomid=geomid).cast(origins, directions)
    check(hits, expected, far=1.2)
    assert 0.1 < (hits.distance < 0).double().mean() < 0.9


# MuJoCo Warp never moves the geoms of fixed bodies, but their sizes count.
@pytest.mark.parametrize(
  ("engine", "field"),
  [("native", "body_pos"), ("native", "geom_size"), pytest.param("warp", "geom_size", marks=pytest.mark.warp)],
)
@pytest.mark.parametrize("per_world", [True, False])
def test_ground_that_is_changed_is_seen_as_it_is(engine: str, field: str, per_world: bool) -> None:
  sim = build(rough_ground(), engine)
  origins, directions = random_rays(sim)
  caster = sim.make_ray_caster(NUM_RAYS, geomid=False)
  before = caster.cast(origins, directions).distance.clone()
  casts = []
  graph = sim.capture(lambda: casts.append(caster.cast(origins, directions)))
  if per_world:
    sim.expand_model_fields([field])
    torch.testing.assert_close(caster.cast(origins, directions).distance, before, rtol=0, atol=0)
  changed = copy.copy(sim.mj_model)
  if field == "body_pos":
    rows, factor = changed.body("terrain").id, 3.0
  else:
    rows, factor = np.flatnonzero(changed.geom_type == Geom.mjGEOM_BOX), 0.7
  getattr(changed, field)[rows] *= factor
  sim.model[field][:, rows] *= factor
  graph()
  for hits in (casts[-1], caster.cast(origins, directions)):
    check(hits, mujoco_rays(sim, origins, directions, models=[changed] * NUM_ENVS))
  sim.model[field][:] = sim.default_field(field)
  torch.testing.assert_close(caster.cast(origins, directions).distance, before, rtol=0, atol=0)
  sim.close()


def test_ground_that_is_changed_right_after_its_memory_was_replaced_is_seen_as_it_is() -> None:
  sim = build(rough_ground(), "native")
  origins, directions = random_rays(sim)
  caster = sim.make_ray_caster(NUM_RAYS, geomid=False)
  # Writes that change nothing, so that the next memory could come to as many of them.
  for _ in range(2):
    sim.model.body_pos.mul_(1.0)
  caster.cast(origins, directions)
  sim.expand_model_fields(["body_pos"])
  changed = copy.copy(sim.mj_model)
  terrain = changed.body("terrain").id
  changed.body_pos[terrain] *= 3.0
  sim.model.body_pos[:, terrain].mul_(3.0)
  check(caster.cast(origins, directions), mujoco_rays(sim, origins, directions, models=[changed] * NUM_ENVS))
  sim.close()


def test_ground_is_merged_once_for_all_casters_that_see_the_same() -> None:
  sim = build(rough_ground(), "native")
  casters: list[Any] = [sim.make_ray_caster(count, geomid=False) for count in (1, 2)]
  first, second = (caster._cast.__self__._ground for caster in casters)
  assert first is second is not None
  assert first.model.nmeshface > 36 * 12
  assert first.model.ngeom == 1 + 4  # Fields, floor and pole stay as they are.


def test_moving_geoms_may_differ_per_world_while_the_ground_is_trusted() -> None:
  sim = build(rough_ground(), "native")
  caster = sim.make_ray_caster(NUM_RAYS, geomid=False)
  sim.expand_model_fields(["geom_size"])
  sim.model.geom_size[1, sim.mj_model.geom("ball").id] = 0.2
  caster.cast(*random_rays(sim))
  assert sim.fixed_geoms_are_in_place()
  sim.model.geom_size[1, sim.mj_model.geom("box0").id] = 0.2
  assert not sim.fixed_geoms_are_in_place()


def test_triangles_are_counter_clockwise_from_outside_and_closed() -> None:
  model = rough_ground().compile()
  flat = fixed_geoms(model) & np.isin(model.geom_type, (Geom.mjGEOM_BOX, Geom.mjGEOM_MESH, Geom.mjGEOM_HFIELD))
  for geom in np.flatnonzero(flat):
    (vertices, triangles), owner = triangulate(model, np.array([geom], dtype=np.int32))
    assert (owner == geom).all()
    points = np.unique(vertices.round(9), axis=0, return_inverse=True)[1].ravel()[triangles]
    edges = {(int(a), int(b)) for a, b in np.concatenate([points[:, [0, 1]], points[:, [1, 2]], points[:, [2, 0]]])}
    if model.geom_type[geom] != Geom.mjGEOM_HFIELD:  # The box that a field stands on is inside of it.
      assert edges == {(b, a) for a, b in edges}
    a, b, c = vertices[triangles].swapaxes(0, 1)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 > 0.0
