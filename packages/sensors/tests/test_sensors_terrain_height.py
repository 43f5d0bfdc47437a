"""Heights above the ground: against closed forms and mj_ray, fresh, and never polluted by rays that see nothing."""

from typing import Any

import numpy as np
import pytest
import torch
from mjlab_sensors import (
  FrameMatch,
  GridPatternCfg,
  RayCastSensorCfg,
  RingPatternCfg,
  SensorCfg,
  TerrainHeightSensor,
  TerrainHeightSensorCfg,
)
from mjlab_sensors.frames import FrameType
from mjlab_sensors.terrain_height import HeightReduction
from mjlab_sim import Simulation
from scipy.spatial.transform import Rotation
from sensor_scenes import Count, place, simulate, with_robot

FEET = FrameMatch(type="site", pattern="foot_.*", entity="robot")
REDUCTIONS: tuple[HeightReduction, ...] = ("min", "max", "mean", "none")
GROUND_Z = 0.3
PLANE = f'<geom type="plane" size="0 0 1" pos="0 0 {GROUND_Z}"/>'

# Visible shells are in group 1; groups decide what counts as ground.
ROBOT = """
<mujoco>
  <worldbody>
    <body name="base" pos="0 0 1">
      <freejoint/>
      <geom name="shell" group="1" size="0.05"/>
      <site name="foot_left" pos="0 0.1 0"/>
      <site name="head" pos="0 0 0.2"/>
      <site name="foot_right" pos="0 -0.1 0" euler="0 0 30"/>
    </body>
  </worldbody>
</mujoco>
"""


def build(*cfgs: SensorCfg, terrain: str = PLANE, num_envs: int = 3) -> tuple[Simulation, list[TerrainHeightSensor]]:
  return simulate(with_robot(ROBOT, terrain), *cfgs, num_envs=num_envs)


def test_height_over_a_plane_is_the_height_of_the_frame_wherever_the_plane_is() -> None:
  sim, sensors = build(*[TerrainHeightSensorCfg(frames=FEET, reduction=how, max_distance=2.0) for how in REDUCTIONS])
  tilt = Rotation.from_euler("x", 30, degrees=True)
  place(sim, (0, 0, 1, None), (3, 1, 0.5, Rotation.from_euler("z", 70, degrees=True)), (0, 0, 1, tilt))
  expected = sim.data.site_xpos[:, [0, 2], 2] - GROUND_Z
  for sensor in sensors[:3]:
    torch.testing.assert_close(sensor.data.heights, expected)
    assert sensor.data.valid.all()
  torch.testing.assert_close(sensors[3].data.heights, expected[..., None].expand(3, 2, 9))
  assert sensors[0].frame_names == ("robot/foot_left", "robot/foot_right")


def test_a_foot_that_sank_into_the_ground_reads_zero() -> None:
  box = f'<geom type="box" size="5 5 0.5" pos="0 0 {GROUND_Z - 0.5}"/>'
  for terrain, depths in ((PLANE, (0.001, 0.05)), (box, (0.001, 0.05, 0.3, 0.7))):
    sim, (sensor,) = build(TerrainHeightSensorCfg(frames=FEET), terrain=terrain)
    for depth in depths:
      place(sim, (0, 0, GROUND_Z - depth, None), (0, 0, GROUND_Z, None), (0, 0, GROUND_Z + depth, None))
      heights = sensor.data.heights[:, 0]
      torch.testing.assert_close(heights, torch.tensor((0.0, 0.0, depth), dtype=sim.dtype), atol=1e-9, rtol=0.0)
      assert sensor.data.valid.all()


def test_a_plane_that_needs_no_rays_reads_as_the_rays_do(monkeypatch: pytest.MonkeyPatch) -> None:
  cfgs = [TerrainHeightSensorCfg(frames=FEET, reduction=how, max_distance=0.6) for how in REDUCTIONS]
  sim, sensors = build(*cfgs)
  turned = Rotation.from_euler("xz", (40, 70), degrees=True)
  place(sim, (0, 0, GROUND_Z + 0.9, None), (3, 1, GROUND_Z + 0.3, turned), (0, 0, GROUND_Z - 0.05, None))
  direct = [(sensor.data.heights.clone(), sensor.data.valid.clone()) for sensor in sensors]
  monkeypatch.setattr(Simulation, "fixed_geoms_are_in_place", lambda sim: False)
  for sensor, (heights, valid) in zip(sensors, direct, strict=True):
    by_rays = sensor._read()
    torch.testing.assert_close(heights, by_rays.heights)
    assert torch.equal(valid, by_rays.valid)
  assert not direct[0][1].all()
  assert direct[0][1].any()


@pytest.mark.parametrize("per_world", [True, False])
def test_a_plane_that_moved_is_seen_by_rays(per_world: bool) -> None:
  sim, (sensor,) = build(TerrainHeightSensorCfg(frames=FEET, max_distance=2.0))
  assert sensor._plane is not None
  assert sensor.data.heights[0, 0] == pytest.approx(1.0 - GROUND_Z)
  if per_world:
    sim.expand_model_fields(["geom_pos"])
    sim.model.geom_pos[1, 0, 2] += 0.1
  else:
    sim.model.geom_pos[:, 0, 2] += 0.1
  moved = torch.tensor([0.0 if per_world else 0.1, 0.1, 0.0 if per_world else 0.1], dtype=sim.dtype)
  torch.testing.assert_close(sensor.data.heights, (1.0 - GROUND_Z - moved)[:, None].expand(3, 2))


def test_a_reading_costs_few_operations(monkeypatch: pytest.MonkeyPatch, count_operations: Count) -> None:
  sim, (sensor,) = build(TerrainHeightSensorCfg(frames=FEET))
  _ = sensor.data  # The first reading looks whether the plane is where it was.
  assert count_operations(sensor._read) <= 5
  monkeypatch.setattr(Simulation, "fixed_geoms_are_in_place", lambda sim: False)
  sim.step()
  _ = sim.version
  # Whatever the engine's caster does is not ours.
  caster = sensor._caster
  hits = caster.cast(torch.zeros(3, 18, 3, dtype=sim.dtype), torch.ones(3, 18, 3, dtype=sim.dtype))
  monkeypatch.setattr(caster, "cast", lambda: hits)
  assert count_operations(sensor._read) <= 20


@pytest.mark.parametrize("alignment", ["yaw", "world", "base"])
def test_heights_are_those_of_what_rays_hit_in_random_scenes(alignment: Any) -> None:
  rng = np.random.default_rng(3)
  geoms = [
    f'<geom type="{kind}" size="{" ".join(f"{v:.3f}" for v in rng.uniform(0.05, 0.3, 3))}" '
    f'pos="{" ".join(f"{v:.3f}" for v in (*rng.uniform(-1, 1, 2), rng.uniform(0, 0.2)))}" '
    f'euler="{" ".join(f"{v:.1f}" for v in rng.uniform(-90, 90, 3))}"/>'
    for kind in ("box", "sphere", "capsule", "cylinder", "ellipsoid", "box") * 4
  ]
  fields: dict[str, Any] = {
    "frames": FrameMatch(type="site", pattern=("head", "foot_.*"), entity="robot", preserve_order=True),
    "pattern": GridPatternCfg(size=(0.8, 0.4), resolution=0.2),
    "alignment": alignment,
    "max_distance": 0.9,
    "start_height": 0.05,
  }
  cfgs = [TerrainHeightSensorCfg(reduction=reduction, **fields) for reduction in REDUCTIONS]
  # Another test compares its rays with MuJoCo's.
  scan = RayCastSensorCfg(geom_groups=(0,), **fields)
  num_envs, seen = 4, 0
  sim, (*sensors, rays) = build(*cfgs, scan, terrain="".join(geoms), num_envs=num_envs)
  for _ in range(5):
    place(sim, *[(*rng.uniform(-1, 1, 2), rng.uniform(0.6, 1.3), Rotation.random(rng=rng)) for _ in range(num_envs)])
    hits: Any = rays.data
    points, normals, valid = (value.unflatten(1, (3, -1)) for value in (hits.hit_pos_w, hits.normals_w, hits.valid))
    down = torch.tensor((0.0, 0.0, -1.0), dtype=sim.dtype)
    directions = hits.frame_mat_w @ down if alignment == "base" else down.expand(num_envs, 3, 3)
    heights = (hits.frame_pos_w[..., None, 2] - points[..., 2]).clamp(min=0.0)
    # A ray that leaves something began in it.
    heights *= (normals * directions[:, :, None]).sum(-1) < 0.0
    any_seen, count = valid.any(-1), valid.sum(-1).clamp(min=1)
    for sensor, reduced in zip(
      sensors,
      (
        heights.where(valid, torch.inf).amin(-1),
        heights.where(valid, -torch.inf).amax(-1),
        heights.where(valid, 0.0).sum(-1) / count,
        heights,
      ),
      strict=True,
    ):
      expected_valid = valid if reduced.ndim == 3 else any_seen
      expected = reduced.where(expected_valid, 0.9)
      torch.testing.assert_close(sensor.data.heights, expected, rtol=0.0, atol=1e-9)
      assert torch.equal(sensor.data.valid, expected_valid)
    seen += int(valid.sum())
  assert 100 < seen < 5 * num_envs * 3 * 15 - 100


def test_rays_over_an_edge_do_not_pollute_the_others() -> None:
  # Half of the ring is over the void.
  table = '<geom type="box" size="1 1 0.1" pos="-1 0 0.4"/>'
  pattern = RingPatternCfg(radius=0.05, num_samples=8, include_center=False)
  sim, sensors = build(
    *[
      TerrainHeightSensorCfg(
        frames=FrameMatch(type="site", pattern="head", entity="robot"), pattern=pattern, reduction=how, max_distance=3.0
      )
      for how in REDUCTIONS
    ],
    terrain=table,
  )
  place(sim, (0.001, 0, 1, None), (-0.5, 0, 1, None), (5, 0, 1, None))
  for sensor in sensors[:3]:
    torch.testing.assert_close(sensor.data.heights[:, 0], torch.tensor((0.7, 0.7, 3.0), dtype=sim.dtype))
    assert sensor.data.valid[:, 0].tolist() == [True, True, False]
  assert sensors[3].data.valid.sum(-1)[:, 0].tolist() == [3, 8, 0]


def test_only_the_chosen_groups_are_ground() -> None:
  terrain = PLANE + '<geom type="box" group="3" size="1 1 0.1" pos="0 0 0.5"/>'
  sim, sensors = build(
    TerrainHeightSensorCfg(frames=FEET),
    TerrainHeightSensorCfg(frames=FEET, geom_groups=(0, 3)),
    TerrainHeightSensorCfg(frames=FEET, geom_groups=(3,)),
    terrain=terrain,
  )
  del sim
  for sensor, height in zip(sensors, (0.7, 0.4, 0.4), strict=True):
    assert sensor.data.heights[0, 0].item() == pytest.approx(height)


def test_the_body_of_the_frames_can_be_looked_through() -> None:
  head = FrameMatch(type="body", pattern="base", entity="robot")
  sim, (blocked, through) = build(
    TerrainHeightSensorCfg(frames=head, geom_groups=None, pattern=RingPatternCfg(num_samples=0)),
    TerrainHeightSensorCfg(
      frames=head, geom_groups=None, pattern=RingPatternCfg(num_samples=0), exclude_parent_body=True
    ),
  )
  del sim
  assert blocked.data.heights[0, 0] == 0.0
  assert through.data.heights[0, 0].item() == pytest.approx(0.7)


def test_frames_may_be_sites_bodies_or_geoms() -> None:
  kinds: tuple[tuple[FrameType, str], ...] = (("site", "head"), ("body", "base"), ("geom", "shell"))
  sim, sensors = build(
    *[TerrainHeightSensorCfg(frames=FrameMatch(type=kind, pattern=name, entity="robot")) for kind, name in kinds]
  )
  del sim
  for sensor, height in zip(sensors, (0.9, 0.7, 0.7), strict=True):
    assert sensor.data.heights[0, 0].item() == pytest.approx(height)


def test_a_grid_is_centred_and_counts_its_ends() -> None:
  points, directions = GridPatternCfg(size=(1.6, 1.0), resolution=0.1).rays()
  assert points.shape == directions.shape == (187, 3)
  np.testing.assert_allclose(points[0], (-0.8, -0.5, 0))
  np.testing.assert_allclose(points[1], (-0.7, -0.5, 0))
  np.testing.assert_allclose(points[-1], (0.8, 0.5, 0))
  np.testing.assert_allclose(directions, np.tile((0, 0, -1), (187, 1)))
  uneven, _ = GridPatternCfg(size=(1.0, 0.0), resolution=0.3).rays()
  np.testing.assert_allclose(uneven[:, 0], (-0.45, -0.15, 0.15, 0.45))
  assert (uneven[:, 1] == 0).all()
  starts, directions = GridPatternCfg(size=(0.4, 0.2), resolution=0.2, direction="forward").rays()
  np.testing.assert_allclose(starts, [[0, y, z] for z in (-0.1, 0.1) for y in (-0.2, 0.0, 0.2)], atol=1e-12)
  assert (directions == (1.0, 0.0, 0.0)).all()


def test_a_ring_is_round_and_may_have_a_centre() -> None:
  with_centre, _ = RingPatternCfg(radius=0.04, num_samples=4).rays()
  np.testing.assert_allclose(
    with_centre, 0.04 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)]), atol=1e-12
  )
  assert len(RingPatternCfg(radius=0.04, num_samples=4, include_center=False).rays()[0]) == 4


def test_each_frame_looks_through_its_own_body_only() -> None:
  # The frame of the terrain lies under the robot, whose shell hides the sky from it, not the ground from the robot.
  frames = FrameMatch(type="body", pattern=("terrain", "robot/base"), preserve_order=True)
  sim, (sensor,) = build(
    TerrainHeightSensorCfg(
      frames=frames,
      geom_groups=None,
      pattern=RingPatternCfg(num_samples=0),
      exclude_parent_body=True,
      start_height=1.2,
      max_distance=2.0,
      reduction="none",
    )
  )
  del sim
  assert sensor.data.heights[0].flatten().tolist() == pytest.approx([0.0, 0.7])
  assert sensor.data.valid[0].flatten().tolist() == [True, True]
