"""What all sensors promise: read once a state and never stale, shapes as documented, drawn, reset and saved alike."""

import dataclasses
import inspect
import re
from collections.abc import Callable
from typing import Any, get_args

import mujoco
import numpy as np
import pytest
import torch
from mjlab_core import quat_apply
from mjlab_sensors import (
  BuiltinSensorCfg,
  ContactMatch,
  ContactSensorCfg,
  FrameMatch,
  ImuSensorCfg,
  LidarPatternCfg,
  ObjRef,
  RayCastSensorCfg,
  SensorCfg,
  TerrainHeightSensorCfg,
)
from mjlab_sensors.contact import ContactField
from sensor_scenes import Count, Sketch, World, documentation

NUM_ENVS = 3
ROBOT = """
<mujoco>
  <worldbody>
    <geom name="ground" type="plane" size="0 0 1"/>
    <body name="box" pos="0 0 0.0995" euler="0 0 30">
      <freejoint/>
      <geom name="box" type="box" size="0.1 0.1 0.1" mass="1"/>
      <site name="left" pos="0 0.05 0.1"/>
      <site name="right" pos="0 -0.05 0.1" euler="20 0 0"/>
    </body>
  </worldbody>
</mujoco>
"""
SITES = FrameMatch(type="site", pattern="left|right")
LEFT = ObjRef(type="site", name="left")
CFGS: tuple[SensorCfg, ...] = (
  BuiltinSensorCfg(name="gyro", sensor_type="gyro", obj=LEFT),
  ContactSensorCfg(
    name="contact",
    primary=ContactMatch(mode="body", pattern="box"),
    fields=get_args(ContactField),
    num_slots=4,
    track_air_time=True,
    history_length=2,
  ),
  ContactSensorCfg(name="net", primary=ContactMatch(mode="geom", pattern="box"), reduce="netforce"),
  ImuSensorCfg(name="imu", site=LEFT, gyro_bias=0.2, accelerometer_bias=0.3, orientation_bias=0.1, gyro_walk=0.05),
  RayCastSensorCfg(
    name="lidar", frames=SITES, pattern=LidarPatternCfg(rows=4, columns=6, vertical_fov=(-60, 10)), identify_geoms=True
  ),
  TerrainHeightSensorCfg(name="height", frames=SITES, exclude_parent_body=True),
  TerrainHeightSensorCfg(name="heights", frames=SITES, exclude_own_tree=True, alignment="base", reduction="none"),
)
NAMES = [cfg.name for cfg in CFGS]


def build(seed: int = 0) -> World:
  """A simulation with every kind of sensor."""
  world = World(mujoco.MjSpec.from_string(ROBOT), *CFGS, num_envs=NUM_ENVS, seed=seed)
  world.sim.data.qvel[:] = 0.1
  return world


@pytest.fixture
def world() -> World:
  return build()


def values(reading: Any) -> dict[str, torch.Tensor]:
  """All tensors of a reading by name, properties included."""
  if isinstance(reading, torch.Tensor):
    return {"": reading}
  names = [field.name for field in dataclasses.fields(reading)]
  names += [name for name, member in vars(type(reading)).items() if isinstance(member, property)]
  return {name: value for name in names if (value := getattr(reading, name)) is not None}


def copies(reading: Any) -> dict[str, torch.Tensor]:
  return {name: value.clone() for name, value in values(reading).items()}


@pytest.mark.parametrize("name", NAMES)
def test_a_second_reading_costs_nothing_and_none_is_stale(world: World, name: str, count_operations: Count) -> None:
  sensor = world.sensors[name]
  world.step(20)
  # What is done, and which readings it must change. Contacts tell of the substep just done, whatever is written since.
  changes: list[tuple[Callable[[], object], set[str]]] = [
    (world.step, set(NAMES) - {"contact"}),
    (lambda: world.sim.data.qpos[:, 2].add_(0.03), {"lidar", "height", "heights"}),
    (lambda: world.sim.data.qvel.add_(0.2), {"gyro", "imu"}),
    (lambda: world.reset(torch.tensor([True, False, False])), set(NAMES)),
  ]
  for change, changed in changes:
    before = copies(sensor.data)
    assert count_operations(lambda: sensor.data) == 0
    assert sensor.data is sensor.data
    change()
    now = copies(sensor.data)
    # A reading that is computed again is the same.
    for key, value in values(sensor._read()).items():
      torch.testing.assert_close(now[key], value, rtol=0, atol=0)
    if name in changed:
      assert any(not torch.equal(now[key], value) for key, value in before.items())


@pytest.mark.parametrize("name", NAMES)
def test_documented_shapes_are_the_real_ones(world: World, name: str) -> None:
  sensor: Any = world.sensors[name]
  world.step()
  sizes = {"num_envs": NUM_ENVS, "3": 3, "4": 4, "dim": 3}
  if hasattr(sensor, "num_frames"):
    sizes |= {"num_frames": sensor.num_frames, "rays_per_frame": sensor.rays_per_frame}
    sizes["num_rays"] = sensor.num_frames * sensor.rays_per_frame
  if hasattr(sensor, "contact_shape"):
    sizes |= {"num_contacts": int(np.prod(sensor.contact_shape)), "history_length": sensor.history_length}
    sizes["num_primaries"] = sensor.contact_shape[0]
  for field, value in values(sensor.data).items():
    doc = documentation(type(sensor.data), field) if field else inspect.getdoc(type(sensor))
    assert doc is not None
    shapes = re.findall(r"\((num_envs[^()]*)\)", doc)
    if doc.endswith("`heights`."):  # The shape of another field.
      shapes = [", ".join(("num_envs", "num_frames", "rays_per_frame")[: value.ndim])]
    real = [tuple(sizes[size.strip()] for size in shape.split(",")) for shape in shapes]
    assert tuple(value.shape) in real, field
    assert value.dtype in (torch.bool, torch.int32, world.sim.dtype), field


@pytest.mark.parametrize("name", ["gyro", "lidar", "height", "heights"])
def test_nothing_derived_is_saved(world: World, name: str) -> None:
  _ = world.sensors[name].data
  assert world.sensors[name].state_dict() == {}


@pytest.mark.parametrize("name", NAMES)
def test_a_reset_touches_masked_worlds_only(name: str) -> None:
  mask = torch.tensor([False, True, False])
  readings, states = [], []
  for resets in (False, True):
    world = build()
    for substep in range(12):
      if resets and substep in (4, 9):
        world.reset(mask)
      elif substep in (4, 9):
        # Draws are made for all worlds, whatever the mask.
        world.reset(torch.zeros(NUM_ENVS, dtype=torch.bool))
      world.step()
    readings.append(values(world.sensors[name].data))
    states.append(world.sensors[name].state_dict())
  for first, second in (readings, states):
    for key, value in first.items():
      assert torch.equal(value[~mask], second[key][~mask]), key


@pytest.mark.parametrize("name", NAMES)
def test_a_saved_state_goes_on_as_it_would_have(name: str) -> None:
  world, other = build(seed=0), build(seed=1)
  world.step(5)
  other.step(2)
  _ = other.sensors[name].data
  other.sensors[name].load_state_dict(world.sensors[name].state_dict())
  other.sim.load_state_dict(world.sim.state_dict())
  twin = values(other.sensors[name].data)
  for key, value in values(world.sensors[name].data).items():
    if key != "linear_acceleration" and key not in get_args(ContactField):  # Of the substep done here.
      torch.testing.assert_close(twin[key], value, msg=key)


@pytest.mark.parametrize("name", NAMES)
def test_every_sensor_draws_itself_in_the_worlds_shown(world: World, name: str) -> None:
  world.sim.data.qpos[:, 0] = torch.tensor((0.0, 10.0, 20.0))
  world.step(20)
  draw: Any = Sketch()
  world.sensors[name].debug_draw(draw)
  assert draw.shapes
  for shape, calls in draw.shapes.items():
    for call in calls:
      rows = {len(part) for part in call if isinstance(part, torch.Tensor)}
      assert len(rows) == 1, shape
      place = call[0]
      assert place.shape[1] == 3
      assert torch.isfinite(place).all()
      # Worlds 0 and 2 stand at 0 and 20; what is seen may be as far as rays see.
      assert ((place[:, 0].abs() < 3) | ((place[:, 0] - 20).abs() < 3)).all(), (shape, place)
  assert sum(len(call[0]) for calls in draw.shapes.values() for call in calls) >= 2
  # Few calls, however many worlds, frames and rays.
  assert sum(map(len, draw.shapes.values())) <= 2


def test_forces_are_drawn_as_they_act_on_the_primary(world: World) -> None:
  world.step(300)
  for name in ("contact", "net"):
    draw: Any = Sketch()
    world.sensors[name].debug_draw(draw)
    ((start, end, *_),) = draw.shapes["arrows"]
    arrows = (end - start).unflatten(0, (2, -1)).sum(1)
    scale = world.sim.mj_model.vis.map.force / world.sim.mj_model.stat.meanmass
    # The ground holds the box up.
    torch.testing.assert_close(
      arrows / scale, torch.tensor([[0.0, 0.0, 9.81]] * 2, dtype=arrows.dtype), rtol=0.02, atol=0.1
    )


def test_a_unit_points_where_its_orientation_says(world: World) -> None:
  data = world.sensors["imu"].data
  down = torch.tensor((0.0, 0.0, -1.0), dtype=world.sim.dtype).expand(NUM_ENVS, 3)
  torch.testing.assert_close(quat_apply(data.orientation, data.projected_gravity), down)
