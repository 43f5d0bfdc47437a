"""The same sensors on MuJoCo Warp: equal to the native engine within single precision."""

from typing import Any

import numpy as np
import pytest
import torch
from mjlab_sensors import (
  BuiltinSensorCfg,
  ContactMatch,
  ContactSensorCfg,
  FrameMatch,
  GridPatternCfg,
  ImuSensorCfg,
  LidarPatternCfg,
  ObjRef,
  PinholeCameraPatternCfg,
  RayCastSensorCfg,
  Sensor,
  TerrainHeightSensorCfg,
)
from mjlab_sim import Simulation
from sensor_scenes import World, simulate, with_robot

pytestmark = pytest.mark.warp

ROBOT = """
<mujoco>
  <worldbody>
    <body name="tripod" pos="0 0 0.13" euler="4 7 0">
      <freejoint/>
      <geom name="front" group="1" size="0.03" pos="0.1 0 -0.07"/>
      <geom name="left" group="1" size="0.03" pos="-0.1 0.1 -0.07"/>
      <geom name="right" group="1" size="0.03" pos="-0.1 -0.1 -0.07"/>
      <site name="top" pos="0 0 0.1" euler="0 0 20"/>
    </body>
    <body name="ball" pos="0.5 0 0.051"><freejoint/><geom name="ball" group="1" size="0.05" mass="1"/></body>
  </worldbody>
</mujoco>
"""
# Spheres on a plane touch the same way in both engines; the box is seen by rays alone.
TERRAIN = """
<geom type="plane" size="0 0 1"/>
<geom type="box" size="0.1 1 0.02" pos="-0.15 0 0" contype="0" conaffinity="0"/>
"""
TOP, SITE = FrameMatch(type="site", pattern="top", entity="robot"), ObjRef(type="site", name="top", entity="robot")
GRID = GridPatternCfg(size=(0.4, 0.2), resolution=0.1)
LIDAR = LidarPatternCfg(rows=3, columns=7, vertical_fov=(-60.0, -20.0))


def contacts(name: str, mode: Any, secondary: str = "", **fields: Any) -> ContactSensorCfg:
  """Contacts of all parts of the robot."""
  primary = ContactMatch(mode=mode, pattern=".*", entity="robot")
  other = ContactMatch(mode="body", pattern=secondary) if secondary else None
  return ContactSensorCfg(name=name, primary=primary, secondary=other, **fields)


CFGS = (
  contacts("net", "subtree", "terrain", reduce="netforce", track_air_time=True, history_length=3),
  contacts("slots", "geom", fields=("found", "force", "dist", "normal"), num_slots=3),
  contacts("found", "body", fields=("found",), reduce="none"),
  contacts("pairs", "body", "terrain|robot/.*", reduce="netforce", track_air_time=True),
  BuiltinSensorCfg(name="accelerometer", sensor_type="accelerometer", obj=SITE),
  BuiltinSensorCfg(name="velocimeter", sensor_type="velocimeter", obj=SITE),
  ImuSensorCfg(name="imu", site=SITE),
  TerrainHeightSensorCfg(name="height", frames=TOP, pattern=GRID, reduction="none"),
  RayCastSensorCfg(name="scan", frames=TOP, pattern=GRID, alignment="yaw", start_height=0.5, geom_groups=(0,)),
  RayCastSensorCfg(name="lidar", frames=TOP, pattern=LIDAR, exclude_own_tree=True, max_distance=2.0),
  RayCastSensorCfg(
    name="depth", frames=TOP, pattern=PinholeCameraPatternCfg(width=5, height=4, fovy=70.0), max_distance=0.6
  ),
)


class Readings(World):
  """One simulation with all sensors."""

  def __init__(self, engine: str, device: str = "cpu", capture: bool = True) -> None:
    super().__init__(with_robot(ROBOT, TERRAIN), *CFGS, engine=engine, device=device, capture=capture)

  def readings(self) -> dict[str, np.ndarray]:
    readings = {}
    for name, sensor in self.sensors.items():
      fields = {"": sensor.data} if isinstance(sensor.data, torch.Tensor) else vars(sensor.data)
      readings |= {
        f"{name}.{field}": value.double().cpu().numpy() for field, value in fields.items() if value is not None
      }
    return readings


@pytest.fixture(scope="module")
def worlds() -> tuple[Readings, Readings]:
  return Readings("native"), Readings("warp")


def test_both_engines_read_the_same_through_steps_resets_and_writes(worlds: tuple[Readings, Readings]) -> None:
  mask = torch.tensor([True, False])
  landed = False
  for substep in range(40):
    for world in worlds:
      if substep == 30:
        world.reset(mask)
      if substep == 35:
        world.sim.data.qpos[1, 0] += 0.05
    if substep not in (30, 35):
      for world in worlds:
        world.step()
    native, warp = (world.readings() for world in worlds)
    for name, expected in native.items():
      scale = max(1.0, np.abs(expected).max())
      np.testing.assert_allclose(warp[name], expected, rtol=0.0, atol=5e-3 * scale, err_msg=f"{name} at {substep}")
    landed |= bool((native["net.last_air_time"][:, 0] > 0.01).any())
  assert landed


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_recorded_step_with_all_sensors_reads_as_an_eager_one_and_never_waits_on_a_gpu() -> None:
  worlds = [Readings("warp", "cuda", capture) for capture in (True, False)]
  mask = torch.tensor([True, False], device="cuda")

  def step(world: Readings, resets: bool) -> None:
    world.step()
    if resets:
      world.reset(mask)
    world.sim.data.qpos[1, 0] += 0.001
    for sensor in world.sensors.values():
      _ = sensor.data

  graphs = [
    [world.sim.capture(lambda world=world, resets=resets: step(world, resets)) for resets in (False, True)]
    for world in worlds
  ]
  for number in range(12):
    # Graphs are recorded after a few eager calls.
    torch.cuda.set_sync_debug_mode("error" if number > 8 else "default")
    try:
      graphs[0][number % 2]()
    finally:
      torch.cuda.set_sync_debug_mode("default")
    graphs[1][number % 2]()
    recorded, eager = (world.readings() for world in worlds)
    for name, expected in eager.items():
      scale = max(1.0, np.abs(expected).max())
      np.testing.assert_allclose(recorded[name], expected, rtol=0.0, atol=1e-3 * scale, err_msg=f"{name} at {number}")
  assert all(graph.num_graphs == 1 for graph in graphs[0])


def feel(cfg: ContactSensorCfg, **options: Any) -> tuple[Simulation, Sensor]:
  """The robot with one sensor on MuJoCo Warp."""
  sim, (sensor,) = simulate(with_robot(ROBOT, TERRAIN), cfg, engine="warp", **options)
  return sim, sensor


def test_a_partial_reset_leaves_no_ghost_of_a_contact() -> None:
  # MuJoCo Warp leaves contacts between geoms 0 and 0 of world 0 when any world is reset, until the next forward pass.
  sim, sensor = feel(
    ContactSensorCfg(
      name="ground",
      primary=ContactMatch(mode="body", pattern="terrain"),
      fields=("found", "force", "dist"),
      num_slots=4,
    )
  )
  for _ in range(300):
    sim.step()
  assert sim.mj_model.geom(0).bodyid[0] == sim.mj_model.body("terrain").id
  for world in (1, 0):
    before = {name: value.clone() for name, value in vars(sensor.data).items() if value is not None}
    assert (before["found"][:, 0] == 4).all()
    mask = torch.arange(2) == world
    sim.reset(mask)
    sensor.reset(mask)
    for name, value in before.items():
      now = getattr(sensor.data, name)
      assert torch.equal(now[~mask], value[~mask]), name
      assert not now[mask].any(), name
    for _ in range(300):
      sim.step()


def test_contacts_that_do_not_fit_the_match_buffer_are_counted_and_reported() -> None:
  # All contacts of the robot, of which there is room for one.
  tripod = ContactMatch(mode="subtree", pattern="tripod", entity="robot")
  sim, _ = feel(ContactSensorCfg(name="feet", primary=tripod), contact_sensor_maxmatch=1, njmax=64)
  sim.data.qpos[0, 2] += 10.0
  for _ in range(300):
    sim.step()
  (report,) = sim.overflow_report()
  assert "1 of 2 worlds needed at least 2 contacts of one sensor" in report
  assert "--env.sim.contact-sensor-maxmatch 8" in report
  assert sim.overflow_report() == []
