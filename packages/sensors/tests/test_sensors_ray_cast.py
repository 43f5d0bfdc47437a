"""Rays from frames: against mj_ray ray by ray, fresh, and never stale; height scans see terrain above the frame."""

from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_core import matrix_from_quat
from mjlab_sensors import (
  FrameMatch,
  GridPatternCfg,
  LidarPatternCfg,
  PinholeCameraPatternCfg,
  RayCastSensor,
  RayCastSensorCfg,
  RingPatternCfg,
)
from mjlab_sim import Simulation
from scipy.spatial.transform import Rotation
from sensor_scenes import Count, get, pixel_rays, place, simulate, with_robot

HEADS = FrameMatch(type="site", pattern=("head", "hand"), entity="robot", preserve_order=True)
EYE = FrameMatch(type="camera", pattern="eye", entity="robot")
PLANE = '<geom type="plane" size="0 0 1"/>'
ASSETS = """
<asset>
  <mesh name="rock" vertex="0 0 .3  .4 .1 0  .1 .2 0  0 .4 0  -.4 -.2 0  0 0 -.2" inertia="shell"
    face="0 1 2  0 2 3  0 3 4  0 4 1  5 2 1  5 3 2  5 4 3  5 1 4"/>
  <hfield name="hills" nrow="3" ncol="4" size=".5 .4 .4 .1" elevation=".1 .5 1 .3  .8 .2 .9 0  .4 .7 .1 .6"/>
</asset>
"""
ROBOT = """
<mujoco>
  <worldbody>
    <body name="base" pos="0 0 1">
      <freejoint/>
      <geom name="shell" size="0.05"/>
      <site name="head" pos="0 0 0.02" euler="0 0 20"/>
      <camera name="eye" resolution="8 6" fovy="60" pos="0.01 0 0" euler="20 10 0"/>
      <camera name="lens" resolution="64 48" sensorsize="0.004 0.003" focal="0.003 0.0035" principal="0.0003 -0.0002"/>
      <body name="arm" pos="0.2 0 0">
        <joint axis="0 1 0"/>
        <geom name="hand" type="box" size="0.05 0.05 0.05" pos="0.1 0 0"/>
        <site name="hand" pos="0.1 0 0" euler="30 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def build(*cfgs: RayCastSensorCfg, terrain: str = PLANE, num_envs: int = 3) -> tuple[Simulation, list[RayCastSensor]]:
  return simulate(with_robot(ROBOT, terrain, ASSETS), *cfgs, num_envs=num_envs)


def random_geoms(rng: np.random.Generator, count: int) -> str:
  def numbers(values: Any) -> str:
    return " ".join(f"{value:.3f}" for value in values)

  def shape(kind: str) -> str:
    asset = {"mesh": 'mesh="rock"', "hfield": 'hfield="hills"'}.get(kind)
    return asset or f'size="{numbers(rng.uniform(0.05, 0.3, 3))}"'

  return "".join(
    f'<geom type="{kind}" {shape(kind)} group="{k % 3}"'
    f' pos="{numbers((*rng.uniform(-1, 1, 2), rng.uniform(0, 0.3)))}" euler="{numbers(rng.uniform(-90, 90, 3))}"/>'
    for k, kind in enumerate(("box", "sphere", "capsule", "cylinder", "ellipsoid", "mesh", "hfield") * count)
  )


def frame_turn(rotation: np.ndarray, alignment: str) -> np.ndarray:
  if alignment == "world":
    return np.eye(3)
  if alignment == "base":
    return rotation
  x, y = rotation[:2, 0], rotation[:2, 1]
  yaw = np.arctan2(x[1], x[0]) if np.hypot(*x) > 0.1 else np.arctan2(y[1], y[0]) - np.pi / 2
  return Rotation.from_euler("z", yaw).as_matrix()


@pytest.mark.parametrize("alignment", ["yaw", "world", "base"])
@pytest.mark.parametrize(
  "pattern",
  [
    GridPatternCfg(size=(0.8, 0.4), resolution=0.2),
    GridPatternCfg(size=(0.4, 0.2), resolution=0.1, direction="forward"),
    RingPatternCfg(radius=0.3, num_samples=7),
    PinholeCameraPatternCfg(),
    LidarPatternCfg(rows=6, columns=12, vertical_fov=(-70.0, 20.0)),
  ],
)
def test_every_ray_equals_mj_ray(alignment: Any, pattern: Any) -> None:
  rng = np.random.default_rng(5)
  start, reach, num_envs, groups = 0.15, 1.1, 4, np.array([1, 0, 1, 0, 0, 0], dtype=np.uint8)
  sim, (sensor,) = build(
    RayCastSensorCfg(
      frames=HEADS,
      pattern=pattern,
      alignment=alignment,
      max_distance=reach,
      start_height=start,
      geom_groups=(0, 2),
      identify_geoms=True,
    ),
    terrain=PLANE + random_geoms(rng, 3),
    num_envs=num_envs,
  )
  poses: list[Any] = [
    (*rng.uniform(-0.5, 0.5, 2), rng.uniform(0.5, 1.0), Rotation.random(rng=rng)) for _ in range(num_envs)
  ]
  # One world looks all but straight up: its heading is that of the y axis.
  poses[0] = (*poses[0][:3], Rotation.from_euler("ZYX", (40, -88, 25), degrees=True))
  place(sim, *poses)
  read = sensor.data
  model = sim.mj_model
  points, directions = pattern.rays()
  rays = len(points)
  assert (sensor.rays_per_frame, sensor.num_rays, sensor.num_frames) == (rays, 2 * rays, 2)
  found, seen = 0, set()
  for world in range(num_envs):
    data = mujoco.MjData(model)
    data.qpos[:] = sim.data.qpos[world].numpy()
    mujoco.mj_kinematics(model, data)
    for frame, name in enumerate(("robot/head", "robot/hand")):
      site = model.site(name)
      turn = frame_turn(data.site_xmat[site.id].reshape(3, 3), alignment)
      np.testing.assert_allclose(read.frame_pos_w[world, frame], data.site_xpos[site.id], atol=1e-12)
      np.testing.assert_allclose(
        matrix_from_quat(read.frame_quat_w[world, frame]).flatten(), data.site_xmat[site.id], atol=1e-12
      )
      for ray in range(rays):
        direction = turn @ directions[ray]
        origin = data.site_xpos[site.id] + turn @ points[ray] - start * direction
        normal, geom = np.zeros(3), np.full(1, -1, dtype=np.int32)
        distance = mujoco.mj_ray(model, data, origin, direction, groups, 1, site.bodyid[0], geom, normal)
        if distance > reach + start:
          distance, normal, geom = -1.0, np.zeros(3), np.full(1, -1, dtype=np.int32)
        at = world, frame * rays + ray
        assert read.distances[at].item() == pytest.approx(distance, abs=1e-9)
        assert read.valid[at].item() == (distance >= 0)
        np.testing.assert_allclose(read.normals_w[at], normal, atol=1e-6)
        np.testing.assert_allclose(read.hit_pos_w[at], origin + max(distance, 0.0) * direction, atol=1e-9)
        assert read.geom_ids is not None
        assert read.geom_ids[at].item() == geom[0]
        seen.add(int(model.geom_type[geom[0]]) if geom[0] >= 0 else -1)
        found += distance >= 0
  torch.testing.assert_close(read.frame_mat_w, matrix_from_quat(read.frame_quat_w))
  torch.testing.assert_close(read.pos_w, read.frame_pos_w[:, 0])
  torch.testing.assert_close(read.quat_w, read.frame_quat_w[:, 0])
  assert 0.2 < found / (num_envs * 2 * rays) < 0.98
  if rays > 50 and alignment != "base":
    # A plane, each primitive, a mesh and a height field, and nothing.
    assert seen == {-1, *range(8)}


def test_a_scan_that_starts_above_sees_terrain_higher_than_its_frame() -> None:
  # Half of the grid is over a step 0.6 m above the frame.
  step = '<geom type="plane" size="0 0 1" group="4"/><geom type="box" size="2 2 0.8" pos="2 0 0.8" group="4"/>'
  head = FrameMatch(type="site", pattern="head", entity="robot")
  grid = GridPatternCfg(size=(1.0, 0.0), resolution=0.1)
  fields: dict[str, Any] = {"frames": head, "pattern": grid, "alignment": "world", "geom_groups": (4,)}
  sim, (at_frame, above) = build(RayCastSensorCfg(**fields), RayCastSensorCfg(start_height=1.0, **fields), terrain=step)
  place(sim, (0, 0, 0.98, None), (0, 0, 0.98, None), (0, 0, 0.98, None))
  heights = torch.where(torch.linspace(-0.5, 0.5, 11) >= 0.0, 1.6, 0.0).double()
  heights = heights.expand(3, 11)
  off_edge = torch.arange(11) != 5
  torch.testing.assert_close(above.data.hit_pos_w[..., 2][:, off_edge], heights[:, off_edge])
  assert (above.data.normals_w[..., 2] == 1.0).all()
  # Without it rays over the step start inside of the box, and leave it where it ends.
  assert not at_frame.data.hit_pos_w[:, 6:, 2].any()


def test_a_robot_looks_through_itself_alone() -> None:
  # A hand right below the head, which would hide the ground.
  fields: dict[str, Any] = {
    "frames": HEADS,
    "pattern": GridPatternCfg(size=(0.6, 0.2), resolution=0.1),
    "alignment": "world",
    "start_height": 0.5,
    "identify_geoms": True,
  }
  sim, (through, not_through) = build(
    RayCastSensorCfg(exclude_own_tree=True, **fields),
    RayCastSensorCfg(**fields),
    terrain=PLANE + '<geom name="wall" type="box" size="0.1 1 0.2" pos="0.4 0 0.2"/>',
  )
  geoms = [
    {sim.mj_model.geom(geom).name for geom in get(sensor.data.geom_ids).unique()} for sensor in (through, not_through)
  ]
  assert geoms[0] == {"", "wall"}
  assert {"robot/shell", "robot/hand"} & geoms[1]
  # Of the hits on the ground, those of both agree.
  same = get(through.data.geom_ids) == get(not_through.data.geom_ids)
  assert torch.equal(through.data.hit_pos_w[same], not_through.data.hit_pos_w[same])


def test_a_reading_works_in_memory_that_stays() -> None:
  sim, sensors = build(*[RayCastSensorCfg(frames=HEADS, alignment=how) for how in ("base", "yaw", "world")])
  for sensor in sensors:
    _ = sensor.data
  rays = [rays for sensor in sensors for rays in (sensor._caster.origins, sensor._caster.directions)]
  before = [(ray.data_ptr(), ray._version) for ray in rays]
  sim.data.qpos[:, 2] += 0.1
  for sensor in sensors:
    _ = sensor.data
  assert [ray.data_ptr() for ray in rays] == [address for address, _ in before]
  # Directions of rays that never turn are written once, when the sensor is built.
  turned = [ray._version != version for ray, (_, version) in zip(rays, before, strict=True)]
  assert turned == [True, True, True, False, True, False]


def test_rays_without_a_hit_are_marked() -> None:
  sim, (sensor,) = build(RayCastSensorCfg(frames=HEADS, max_distance=0.9, pattern=RingPatternCfg(num_samples=3)))
  tilted = Rotation.from_euler("x", 60, degrees=True)
  place(sim, (0, 0, 0.5, None), (0, 0, 2, None), (0, 0, 0.6, tilted))
  read = sensor.data
  assert read.valid[0].all()
  assert not read.valid[1:, :4].any()
  missed = ~read.valid
  assert (read.distances[missed] == -1.0).all()
  assert not read.normals_w[missed].any()
  assert (read.hit_pos_w[1, 0] == read.pos_w[1]).all()


def test_a_reading_costs_few_operations(monkeypatch: pytest.MonkeyPatch, count_operations: Count) -> None:
  sim, sensors = build(*[RayCastSensorCfg(frames=EYE, alignment=how) for how in ("base", "yaw", "world")])
  _ = sim.version
  for sensor, most in zip(sensors, (16, 18, 8), strict=True):
    caster = sensor._caster
    rays = torch.ones(3, sensor.num_rays, 3, dtype=sim.dtype)
    hits = caster.cast(rays, rays)
    monkeypatch.setattr(caster, "cast", lambda hits=hits: hits)
    assert count_operations(sensor._read) <= most


@pytest.mark.parametrize(("camera", "size"), [("eye", (0, 0)), ("eye", (10, 4)), ("lens", (0, 0)), ("lens", (32, 24))])
def test_pixels_of_a_camera_are_those_of_its_image(camera: str, size: tuple[int, int]) -> None:
  room = '<geom type="box" size="30 20 10"/>'
  pattern = PinholeCameraPatternCfg.from_mujoco_camera(f"robot/{camera}", width=size[0], height=size[1])
  frame = FrameMatch(type="camera", pattern=camera, entity="robot")
  sim, (sensor,) = build(RayCastSensorCfg(frames=frame, pattern=pattern, max_distance=100.0), terrain=room, num_envs=1)
  place(sim, (1, 2, 3, Rotation.from_euler("xyz", (20, 30, 40), degrees=True)))
  model = sim.mj_model
  data = mujoco.MjData(model)
  data.qpos[:] = sim.data.qpos[0].numpy()
  mujoco.mj_forward(model, data)
  number = model.camera(f"robot/{camera}").id
  width, height = (size[0] or model.cam_resolution[number, 0]), (size[1] or model.cam_resolution[number, 1])
  _, expected, _ = pixel_rays(model, data, number, int(width), int(height))
  read = sensor.data
  assert read.valid.all()
  seen = ((read.hit_pos_w - read.pos_w[:, None]) / read.distances[..., None])[0]
  np.testing.assert_allclose(seen, expected.reshape(-1, 3), atol=1e-6)
  np.testing.assert_allclose(read.pos_w[0], data.cam_xpos[number], atol=1e-9)


def test_the_first_row_is_the_top_and_each_runs_to_the_right() -> None:
  _, rays = PinholeCameraPatternCfg(width=4, height=3, fovy=90.0).rays()
  image = rays.reshape(3, 4, 3)
  assert (np.diff(image[..., 0], axis=1) > 0).all()
  assert (np.diff(image[..., 1], axis=0) < 0).all()
  planar = image / -image[..., 2:]
  np.testing.assert_allclose(planar[0, 0], (-1.0, 2 / 3, -1.0), atol=1e-12)  # The pixel's centre, not its corner.
  np.testing.assert_allclose(PinholeCameraPatternCfg(width=1, height=1).rays()[1], [(0, 0, -1)])


def test_an_intrinsic_matrix_is_used_whole() -> None:
  matrix = [[100.0, 0.0, 7.0], [0.0, 80.0, 5.5], [0.0, 0.0, 1.0]]
  pattern = PinholeCameraPatternCfg.from_intrinsic_matrix(matrix, width=16, height=12)
  assert pattern == PinholeCameraPatternCfg.from_intrinsic_matrix(np.ravel(matrix).tolist(), width=16, height=12)
  points = pattern.rays()[1]
  points = points / -points[:, 2:]
  # Right, up, backward to right, down, forward; then pixels by K.
  pixels = (points * (1, -1, -1)) @ np.transpose(matrix)
  column, row = np.meshgrid(np.arange(16) + 0.5, np.arange(12) + 0.5)
  np.testing.assert_allclose(pixels[:, :2], np.stack((column.ravel(), row.ravel()), axis=1), atol=1e-9)


def angles(pattern: LidarPatternCfg) -> tuple[np.ndarray, np.ndarray]:
  """Elevation of each row and azimuth of each column [deg]."""
  starts, rays = pattern.rays()
  assert not starts.any()
  np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0)
  x, y, z = np.moveaxis(rays.reshape(pattern.rows, pattern.columns, 3), -1, 0)
  elevation, azimuth = np.degrees(np.arcsin(z)), np.degrees(np.arctan2(y, x))
  np.testing.assert_allclose(elevation, elevation[:, :1].repeat(pattern.columns, axis=1), atol=1e-9)
  np.testing.assert_allclose(azimuth, azimuth[:1].repeat(pattern.rows, axis=0), atol=1e-9)
  return elevation[:, 0], azimuth[0]


def test_a_lidar_scans_its_field_from_the_top_left_and_no_direction_twice() -> None:
  elevation, azimuth = angles(LidarPatternCfg(rows=3, columns=4, vertical_fov=(-20.0, 10.0)))
  np.testing.assert_allclose(elevation, (10.0, -5.0, -20.0), atol=1e-9)
  np.testing.assert_allclose(azimuth, (180.0, 90.0, 0.0, -90.0), atol=1e-9)
  elevation, azimuth = angles(LidarPatternCfg(rows=2, columns=5, vertical_fov=(0, 30), horizontal_fov=(-60, 20)))
  np.testing.assert_allclose(elevation, (30.0, 0.0), atol=1e-9)
  np.testing.assert_allclose(azimuth, (20.0, 0.0, -20.0, -40.0, -60.0), atol=1e-9)
  elevation, azimuth = angles(LidarPatternCfg(rows=1, columns=1, vertical_fov=(-10, 30), horizontal_fov=(-40, 20)))
  np.testing.assert_allclose((elevation[0], azimuth[0]), (10.0, -10.0), atol=1e-9)


def test_the_depth_of_a_pixel_is_its_distance_along_the_optical_axis() -> None:
  # A wall at 2 m in front of a camera that looks along x: what a rendered image has in every pixel.
  wall = '<geom type="box" size="0.1 5 5" pos="3.1 0 1" group="0"/>'
  pattern = PinholeCameraPatternCfg(width=6, height=4, fovy=50.0)
  frame = FrameMatch(type="camera", pattern="eye", entity="robot")
  sim, (sensor,) = build(RayCastSensorCfg(frames=frame, pattern=pattern), terrain=wall, num_envs=1)
  # The camera's negative z axis onto the world's x axis, its y axis up.
  eye = sim.mj_model.camera("robot/eye")
  looks = Rotation.from_matrix(np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
  base = looks * Rotation.from_quat(eye.quat, scalar_first=True).inv()
  place(sim, (*(np.array([1.0, 0.0, 1.0]) - base.apply(eye.pos)), base))
  depth = sensor.data.distances[0] * torch.from_numpy(-pattern.rays()[1][:, 2])
  torch.testing.assert_close(depth, torch.full((24,), 2.0, dtype=torch.double))
  assert sensor.data.distances.max() > 2.1
