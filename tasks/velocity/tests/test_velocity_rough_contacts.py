"""Convex collision on rough ground needs no more iterations than on flat ground."""

import mujoco
import numpy as np
import pytest
from mjlab_scene import Scene
from velocity_facts import TASKS

ROUGH = ["Mjlab-Velocity-Rough-Unitree-Go1", "Mjlab-Velocity-Rough-Unitree-G1"]


def contacts(model: mujoco.MjModel, data: mujoco.MjData, iterations: int) -> tuple[np.ndarray, np.ndarray]:
  model.opt.ccd_iterations = iterations
  mujoco.mj_forward(model, data)
  return data.contact.geom.copy(), data.contact.dist.copy()


@pytest.mark.parametrize("name", ROUGH)
def test_as_many_iterations_as_on_flat_ground_find_the_contacts_of_ten_times_as_many(name: str) -> None:
  cfg = TASKS[name].make().env
  scene = Scene(cfg.scene, cfg.decimation)
  cfg.sim.apply(scene.spec)
  model = scene.spec.compile()
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
