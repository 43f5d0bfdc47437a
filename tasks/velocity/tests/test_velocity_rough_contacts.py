"""Collisions on rough ground: the pairs that are tested, and the iterations that convex collision needs."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from mjlab_scene import Scene
from mjlab_sim.warp.collision.grouped_broadphase import grouped_broadphase
from mjlab_sim.warp.internals import nxn_broadphase
from velocity_facts import TASKS

ROUGH = ["Mjlab-Velocity-Rough-Unitree-Go1", "Mjlab-Velocity-Rough-Unitree-G1"]


@cache
def compiled(name: str) -> mujoco.MjModel:
  cfg = TASKS[name].make().env
  scene = Scene(cfg.scene, cfg.decimation)
  cfg.sim.apply(scene.spec)
  return scene.spec.compile()


def pairs(m: Any, d: Any, find: Any) -> set[tuple[int, ...]]:
  """Return world, geoms and identifiers of the pairs that a broad phase lists."""
  kinds = {"collision_worldid": int, "collision_pair": wp.vec2i, "collision_pairid": wp.vec2i}
  found = {name: wp.zeros(d.naconmax, dtype=kind) for name, kind in kinds.items()}
  d.ncollision.zero_()
  find(m, d, SimpleNamespace(**found))
  count = int(d.ncollision.numpy()[0])
  listed = np.concatenate([array.numpy()[:count].reshape(count, -1) for array in found.values()], 1).tolist()
  assert len(set(map(tuple, listed))) == count
  return set(map(tuple, listed))


def contacts(model: mujoco.MjModel, data: mujoco.MjData, iterations: int) -> tuple[np.ndarray, np.ndarray]:
  model.opt.ccd_iterations = iterations
  mujoco.mj_forward(model, data)
  return data.contact.geom.copy(), data.contact.dist.copy()


@pytest.mark.parametrize("name", ROUGH)
def test_as_many_iterations_as_on_flat_ground_find_the_contacts_of_ten_times_as_many(name: str) -> None:
  model = compiled(name)
  usual = model.opt.ccd_iterations
  assert usual == 50
  data, random = mujoco.MjData(model), np.random.default_rng(0)
  fields = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD)
  found = 0
  for _ in range(30):
    mujoco.mj_resetData(model, data)
    # Robots that fell onto a height field, in any pose.
    center = model.geom_pos[random.choice(fields)]
    data.qpos[:3] = center + random.uniform([-3.5, -3.5, 0.0], [3.5, 3.5, 0.35])
    data.qpos[3:7] = random.normal(size=4)
    data.qpos[7:] += 0.4 * random.normal(size=model.nq - 7)
    geoms, distances = contacts(model, data, usual)
    more_geoms, more_distances = contacts(model, data, 10 * usual)
    np.testing.assert_array_equal(geoms, more_geoms)
    np.testing.assert_allclose(distances, more_distances, atol=1e-5)
    found += len(distances)
  assert found > 1000


@pytest.mark.warp
@pytest.mark.parametrize("name", ROUGH)
def test_groups_of_geoms_find_the_pairs_of_a_test_of_every_pair(name: str) -> None:
  model, worlds, random = compiled(name), 60, np.random.default_rng(0)
  m, d, data = mjw.put_model(model), mjw.make_data(model, nworld=worlds, nconmax=500, njmax=10), mujoco.MjData(model)
  positions, rotations = np.zeros((worlds, model.ngeom, 3)), np.zeros((worlds, model.ngeom, 9))
  ground = np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0)
  for world in range(worlds):
    mujoco.mj_resetData(model, data)
    data.qpos[:3] = model.geom_pos[random.choice(ground)] + random.uniform([-3, -3, 0], [3, 3, 1])
    # Half of the robots stand, half of them lie in any pose.
    data.qpos[3:7] = random.normal(size=4) if world % 2 else [1, 0, 0, 0]
    data.qpos[7:] += 0.3 * random.normal(size=model.nq - 7)
    mujoco.mj_kinematics(model, data)
    positions[world], rotations[world] = data.geom_xpos, data.geom_xmat
  d.geom_xpos = wp.array(positions, dtype=wp.vec3)
  d.geom_xmat = wp.array(rotations.reshape(worlds, -1, 3, 3), dtype=wp.mat33)
  ours: Any = grouped_broadphase(model, m, d)
  assert ours.saved > 0.8 * m.nxn_geom_pair_filtered.shape[0]
  expected = pairs(m, d, nxn_broadphase)
  assert len(expected) > 20 * worlds
  assert pairs(m, d, ours.find_pairs) == expected
