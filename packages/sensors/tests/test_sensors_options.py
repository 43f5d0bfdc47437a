"""World-frame contact forces and forward grids."""

import dataclasses
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_sensors import ContactMatch, ContactSensorCfg, FrameMatch, GridPatternCfg, RayCastSensorCfg
from mjlab_sim import Simulation
from sensor_scenes import World, advance

WORLD = """
<mujoco>
  <option cone="elliptic"/>
  <worldbody>
    <geom name="slope" type="plane" size="0 0 1" euler="0 20 0"/>
    <geom name="wall" type="box" size="0.1 2 2" pos="3 0 1"/>
    <body name="box" pos="0 0 0.11" euler="0 20 0">
      <freejoint/>
      <geom name="box" type="box" size="0.1 0.1 0.1" mass="2" friction="1"/>
    </body>
    <body name="head" pos="0 1 1" euler="0 0 10">
      <site name="eye"/>
    </body>
  </worldbody>
</mujoco>
"""


def built(engine: Any, **cfgs: Any) -> tuple[Simulation, dict[str, Any]]:
  named = [dataclasses.replace(cfg, name=name) for name, cfg in cfgs.items()]
  world = World(mujoco.MjSpec.from_string(WORLD), *named, engine=engine)
  return world.sim, world.sensors


@pytest.fixture(params=["native", pytest.param("warp", marks=pytest.mark.warp)])
def engine(request: pytest.FixtureRequest) -> str:
  return request.param


def test_contact_forces_in_the_world_frame_carry_the_weight(engine: str) -> None:
  on: Any = {
    "primary": ContactMatch(mode="body", pattern="box"),
    "secondary": ContactMatch(mode="geom", pattern="slope"),
    "num_slots": 4,
  }
  cfg = ContactSensorCfg(**on, global_frame=True, history_length=2)
  whole = ContactSensorCfg(**on | {"num_slots": 1}, reduce="netforce")
  sim, sensors = built(engine, local=ContactSensorCfg(**on), world=cfg, whole=whole)
  advance(sim, sensors.values(), 300)
  data = sensors["world"].data
  assert data.normal is None
  total = data.force.sum(1).double().cpu().numpy()
  # The box rests on the slope: what it does to the ground is its weight, though normals are tilted.
  np.testing.assert_allclose(total, np.tile([0.0, 0.0, -2.0 * 9.81], (2, 1)), atol=0.05)
  np.testing.assert_allclose(total, sensors["whole"].data.force[:, 0].double().cpu().numpy(), atol=1e-3)
  sizes = [torch.linalg.vector_norm(sensors[name].data.force, dim=-1) for name in ("local", "world")]
  torch.testing.assert_close(*sizes, rtol=1e-4, atol=1e-5)
  torch.testing.assert_close(data.force_history[:, :, 0], data.force)


def test_a_forward_grid_is_parallel_to_the_x_axis_of_its_frame(engine: str) -> None:
  pattern = GridPatternCfg(size=(0.4, 0.2), resolution=0.2, direction="forward")
  starts, directions = pattern.rays()
  assert starts.tolist() == pytest.approx(np.array([[0, y, z] for z in (-0.1, 0.1) for y in (-0.2, 0.0, 0.2)]))
  assert (directions == (1.0, 0.0, 0.0)).all()
  cfg = RayCastSensorCfg(
    frames=FrameMatch(type="site", pattern="eye"), pattern=pattern, alignment="base", max_distance=5.0
  )
  sim, sensors = built(engine, scan=cfg)
  model, data = sim.mj_model, mujoco.MjData(sim.mj_model)
  mujoco.mj_forward(model, data)
  turn = data.site("eye").xmat.reshape(3, 3)
  expected = [
    mujoco.mj_ray(
      model, data, data.site("eye").xpos + turn @ start, turn @ (1.0, 0.0, 0.0), None, 1, -1, np.zeros(1, np.int32)
    )
    for start in starts
  ]
  np.testing.assert_allclose(sensors["scan"].data.distances[1].double().cpu().numpy(), expected, atol=1e-5)
  assert sensors["scan"].data.valid.all()
