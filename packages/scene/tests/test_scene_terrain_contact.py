"""Every type of tile carries a foot on both engines."""

import mujoco
import numpy as np
import pytest
import torch
from mjlab_sim import Simulation, SimulationCfg
from mjlab_terrain import TerrainGridCfg, all_types

FOOT = (0.1, 0.05, 0.02)


@pytest.mark.parametrize("engine", ["native", pytest.param("warp", marks=pytest.mark.warp)])
def test_foot_sized_boxes_do_not_fall_through(engine: str) -> None:
  grid = TerrainGridCfg(types=all_types(), rows=3, tile_size=(6.0, 6.0), border_width=0.0, light=False)
  spec = mujoco.MjSpec()
  terrain = grid.add_to(spec)
  body = spec.worldbody.add_body()
  body.add_freejoint()
  body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=FOOT, mass=1.0, contype=0, conaffinity=1, group=3)
  spec.option.timestep = 0.005
  # A world for each type and difficulty, with a foot at the spawn point, and one with a foot at a place of its own.
  where = np.stack((terrain.origins, terrain.origins))
  where[1, :, :, :2] += np.random.default_rng(0).uniform(-2.0, 2.0, (*terrain.difficulty.shape, 2))
  cfg = SimulationCfg(engine="warp" if engine == "warp" else "native", nconmax=24, njmax=96)
  sim = Simulation(where[..., 0].size, spec, cfg, device="cpu")
  down, geom, ground = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32), np.array([1, 0, 0, 0, 0, 0], np.uint8)
  data = mujoco.MjData(sim.mj_model)
  mujoco.mj_forward(sim.mj_model, data)

  def height(point: np.ndarray) -> float:
    above = np.array((*point[:2], 5.0))
    distance = mujoco.mj_ray(sim.mj_model, data, above, down, ground, 1, -1, geom)
    return 5.0 - distance if distance >= 0.0 else -np.inf

  where[..., 2] = np.apply_along_axis(height, -1, where) + 0.1
  state = sim.data.qpos.view(*where.shape[:-1], 7)
  state[..., :3] = torch.tensor(where)
  state[..., 3] = 1.0
  # A foot lands after 30 steps; the others are enough to sink by 12 cm.
  for _ in range(60):
    sim.step()
  position = state[..., :3].double().numpy()
  fell = position[..., 2] - np.apply_along_axis(height, -1, position)
  for kind, name in enumerate(terrain.type_names):
    # A foot may slip under a tread, by no more than the rise and a tread's thickness.
    reach = 0.02 + (0.2 if name == "open_stairs" else 0.0)
    assert fell[..., kind].min() > -reach, (name, fell[..., kind])
  assert position[..., 2].min() > terrain.height_range[0] - 0.02
  assert sim.overflow_report() == []
