"""Images of cameras: pixel by pixel against MuJoCo's rays and OpenGL, in every world's own colours, and never stale."""

import dataclasses
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import mujoco_warp
import numpy as np
import pytest
import torch
from mjlab_core import MjlabError
from mjlab_sensors import (
  CameraData,
  CameraSensor,
  CameraSensorCfg,
  FrameMatch,
  PinholeCameraPatternCfg,
  RayCastSensorCfg,
)
from mjlab_sim import Simulation
from scipy.spatial.transform import Rotation
from sensor_scenes import Count, Sketch, advance, documentation, pixel_rays, place, simulate

pytestmark = pytest.mark.warp

needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")

ENGINES = ("native", "warp")
NUM_ENVS = 3
SIZE: dict[str, Any] = {"width": 12, "height": 8}
ALL: Any = ("rgb", "depth", "distance", "segmentation")
GEOM = mujoco.mjtObj.mjOBJ_GEOM.value

# The renderer is compiled for the kinds of geoms and the number of lights in a model, so one model serves nearly all
# tests. Nothing in it collides. Light falls straight down and has no highlights: colours are sums.
SCENE = """
<mujoco>
  <default><geom contype="0" conaffinity="0"/></default>
  <option gravity="0 0 0"/>
  <visual><headlight ambient=".1 .1 .1" diffuse=".2 .2 .2" specular="0 0 0"/><map znear=".001" zfar="100"/></visual>
  <statistic extent="1"/>
  <asset>
    <texture name="red" type="2d" builtin="flat" rgb1="1 0 0" width="8" height="8"/>
    <texture name="blue" type="2d" builtin="flat" rgb1="0 0 1" width="8" height="8"/>
    <texture name="sky" type="skybox" builtin="flat" rgb1="0 1 1" width="8" height="48"/>
    <texture name="tiles" type="2d" builtin="checker" rgb1="1 1 0" rgb2="0 1 0" width="8" height="8"/>
    <material name="red" texture="red"/><material name="blue" texture="blue"/>
    <material name="tiles" texture="tiles" texrepeat="2 2"/>
    <mesh name="tent" vertex="-.3 -.2 0  .3 -.2 0  .3 .2 0  -.3 .2 0  0 0 .4"/>
    <hfield name="hill" nrow="4" ncol="5" size=".5 .4 .3 .1"
      elevation="0 0 0 0 0  0 .5 1 .3 0  0 .4 .6 .2 0  0 0 0 0 0"/>
  </asset>
  <worldbody>
    <light name="lamp" type="directional" dir="0 0 -1" diffuse=".4 .4 .4" specular="0 0 0"/>
    <geom name="floor" type="plane" size="4 4 1" rgba="1 .5 .2 1"/>
    <body name="things">
      <geom name="box" type="box" size=".2 .3 .1" pos=".6 0 .1" euler="0 0 20"/>
      <geom name="ball" size=".2" pos="-.6 .2 .3"/>
      <geom name="capsule" type="capsule" size=".1 .2" pos="0 .6 .2" euler="50 0 0"/>
      <geom name="drum" type="cylinder" size=".2 .15" pos=".1 -.6 .2" euler="20 30 0"/>
      <geom name="egg" type="ellipsoid" size=".1 .2 .3" pos="-.7 -.5 .3" group="1"/>
      <geom name="tent" type="mesh" mesh="tent" pos=".7 .7 .02" group="2"/>
      <geom name="hill" type="hfield" hfield="hill" pos="-.8 .9 .001"/>
      <geom name="ghost" size=".3" pos="0 0 .5" rgba="1 1 1 0"/>
      <geom name="hidden" size=".3" pos="0 0 .5" group="4"/>
    </body>
    <body name="robot/base" pos="0 0 2">
      <freejoint/>
      <geom name="shell" size=".05" mass="1"/>
      <camera name="robot/eye" resolution="12 8" fovy="60" pos=".01 0 0" euler="0 0 30"/>
      <camera name="robot/lens" resolution="12 9" sensorsize=".004 .003" focal=".003 .0035" principal=".0003 -.0002"/>
      <camera name="robot/flat" resolution="12 8" projection="orthographic" fovy="2" euler="10 0 0"/>
    </body>
  </worldbody>
</mujoco>
"""


def cfg(name: str, **fields: Any) -> CameraSensorCfg:
  """A camera of 12 x 8 pixels."""
  fields = {**SIZE, **fields}
  return CameraSensorCfg(name=name, **fields)


def eye(name: str = "eye", **fields: Any) -> CameraSensorCfg:
  """The scene's own camera."""
  return cfg(name, camera="robot/eye", **fields)


def build(*cfgs: Any, xml: str = SCENE, num_envs: int = NUM_ENVS, **options: Any) -> tuple[Simulation, list[Any]]:
  settings: dict[str, Any] = {"engine": "native", **options}
  return simulate(mujoco.MjSpec.from_string(xml), *cfgs, num_envs=num_envs, **settings)


def scatter(sim: Simulation) -> None:
  """Every base somewhere above, looking down at a slant."""
  place(
    sim,
    (0.0, 0.1, 1.6, Rotation.from_euler("xyz", (15, -10, 25), degrees=True)),
    (1.4, -1.2, 1.3, Rotation.from_euler("xyz", (35, 30, 10), degrees=True)),
    (-1.0, 0.7, 1.9, Rotation.from_euler("xyz", (-20, -25, 100), degrees=True)),
  )


@pytest.mark.parametrize("engine", ENGINES)
def test_every_pixel_equals_mj_ray(engine: str) -> None:
  names = ("robot/eye", "robot/lens", "robot/flat")
  cfgs = [CameraSensorCfg(camera=name, data_types=("depth", "distance", "segmentation")) for name in names]
  sim, sensors = build(*cfgs, engine=engine)
  scatter(sim)
  model, groups, seen = sim.mj_model, np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8), set()
  for name, sensor in zip(names, sensors, strict=True):
    images, camera = sensor.data, model.camera(name)
    for world in range(NUM_ENVS):
      data = mujoco.MjData(model)
      data.qpos[:] = sim.data.qpos[world].double().numpy()
      mujoco.mj_forward(model, data)
      origins, rays, cosines = pixel_rays(model, data, camera.id, sensor.width, sensor.height)
      np.testing.assert_allclose(images.pos_w[world], data.cam_xpos[camera.id], atol=1e-6)
      np.testing.assert_allclose(images.mat_w[world].flatten(), data.cam_xmat[camera.id], atol=1e-6)
      for row, column in np.ndindex(cosines.shape):
        at, geom = (row, column), np.full(1, -1, dtype=np.int32)
        distance = mujoco.mj_ray(model, data, origins[at], rays[at], groups, 1, model.body("robot/base").id, geom, None)
        planar = distance * cosines[at] if distance >= 0.0 else -1.0
        kind = GEOM if geom[0] >= 0 else -1
        assert images.segmentation[world, :, row, column].tolist() == [geom[0], kind], (name, world, at)
        assert images.distance[world, 0, row, column].item() == pytest.approx(distance, abs=2e-5)
        assert images.depth[world, 0, row, column].item() == pytest.approx(planar, abs=2e-5)
        seen.add(geom[0])
  expected = {model.geom(name).id for name in "floor box ball capsule drum egg tent hill".split()}
  assert seen == expected | {-1}


_OPENGL = """
import sys, mujoco, numpy as np
model = mujoco.MjModel.from_xml_path(sys.argv[1])
data = mujoco.MjData(model)
data.qpos[:] = np.fromstring(sys.argv[2], sep=" ")
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 24, 32) as renderer:
  renderer.update_scene(data, "robot/eye")
  color = renderer.render()
  renderer.enable_depth_rendering()
  depth = renderer.render()
  renderer.disable_depth_rendering()
  renderer.enable_segmentation_rendering()
  np.savez(sys.argv[3], color=color, depth=depth, segmentation=renderer.render())
"""


def test_images_are_those_of_mujocos_renderer(tmp_path: Path) -> None:
  # Of flat things alone, for OpenGL draws round ones with corners.
  round_things = r'<geom name="(ball|capsule|drum|egg|ghost|hidden|shell|hill)".*?/>'
  xml = re.sub(round_things, "", SCENE).replace(
    "<freejoint/>", '<freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
  )
  xml = xml.replace("<visual>", '<visual><quality offsamples="0"/>')
  sim, (sensor,) = build(CameraSensorCfg(camera="robot/eye", width=32, height=24, data_types=ALL), xml=xml, num_envs=1)
  place(sim, (0.4, -1.6, 1.2, Rotation.from_euler("xyz", (55, 0, 0), degrees=True)))
  (tmp_path / "scene.xml").write_text(xml)
  pose = " ".join(map(str, sim.data.qpos[0].tolist()))
  command = [sys.executable, "-c", _OPENGL, str(tmp_path / "scene.xml"), pose, str(tmp_path / "images.npz")]
  drawn = subprocess.run(command, env={**os.environ, "MUJOCO_GL": "egl"}, capture_output=True, text=True)
  if drawn.returncode:
    pytest.skip(f"needs OpenGL without a screen: {drawn.stderr.strip().splitlines()[-1]}")
  expected, images = np.load(tmp_path / "images.npz"), sensor.data
  number = expected["segmentation"][..., 0]
  # At an edge the middle of a pixel may be rounded to either side.
  inner = np.ones(number.shape, dtype=bool)
  for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
    inner &= number == np.roll(number, shift, axis)
  assert inner.mean() > 0.6
  assert set(number[inner]) == {-1, *(sim.mj_model.geom(name).id for name in ("floor", "box", "tent"))}
  np.testing.assert_array_equal(images.segmentation[0].permute(1, 2, 0)[inner], expected["segmentation"][inner])
  seen = inner & (number >= 0)
  np.testing.assert_allclose(images.depth[0, 0][seen], expected["depth"][seen], rtol=1e-3)
  difference = images.rgb[0].permute(1, 2, 0).numpy().astype(int) - expected["color"].astype(int)
  assert np.abs(difference[inner]).max() <= 2


def test_an_object_is_where_the_matrices_of_the_camera_project_it() -> None:
  # What an earlier test asked for, so that the renderer is compiled already.
  names = ("robot/eye", "robot/lens", "robot/flat")
  cfgs = [CameraSensorCfg(camera=name, data_types=("depth", "distance", "segmentation")) for name in names]
  sim, sensors = build(*cfgs)
  scatter(sim)
  sim.expand_model_fields(["cam_fovy"])
  sim.model.cam_fovy[:, sim.mj_model.camera("robot/eye").id] = torch.tensor([50.0, 65.0, 80.0], dtype=sim.dtype)
  shown = 0
  for sensor in sensors[:2]:
    images = sensor.data
    for name in "ball box drum egg".split():
      geom = sim.mj_model.geom(name).id
      centre = sim.data.geom_xpos[:, geom]
      # Right, up, backward to right, down, forward; then pixels by K.
      local = ((centre - images.pos_w)[:, None] @ images.mat_w)[:, 0] * torch.tensor([1.0, -1.0, -1.0])
      pixel = (sensor.intrinsic_matrix @ local[..., None])[..., 0]
      column, row = (pixel[:, :2] / pixel[:, 2:]).floor().long().unbind(-1)
      for world in range(NUM_ENVS):
        if 0 <= column[world] < sensor.width and 0 <= row[world] < sensor.height:
          assert images.segmentation[world, :, row[world], column[world]].tolist() == [geom, GEOM]
          shown += 1
  assert shown > 8


@pytest.mark.parametrize("camera", ["robot/eye", "robot/lens"])
def test_the_intrinsic_matrix_is_that_of_the_pinhole_pattern(camera: str) -> None:
  sim, (sensor,) = build(CameraSensorCfg(camera=camera))
  k = sensor.intrinsic_matrix[1].numpy()
  pattern = PinholeCameraPatternCfg.from_intrinsic_matrix(k, width=sensor.width, height=sensor.height)
  expected = PinholeCameraPatternCfg.from_mujoco_camera(camera).resolve(sim.mj_model)
  np.testing.assert_allclose(pattern.rays()[1], expected.rays()[1], atol=1e-6)


def depth_is(sensor: CameraSensor, *expected: float) -> bool:
  """Return True if all pixels of each world have the expected depth, 1 m by default."""
  assert sensor.data.depth is not None
  depth = torch.tensor(expected or (1.0,) * NUM_ENVS)
  return torch.allclose(sensor.data.depth, depth[:, None, None, None], rtol=0.0, atol=1e-6)


def over_the_floor(sim: Simulation) -> None:
  """The eye of every world a metre above bare floor, at which it looks straight down: all of it has one colour."""
  place(sim, *[(2.5, 2.5, 1.0, None)] * NUM_ENVS)


# Headlight and lamp shine straight down on the floor: ambient, and all of both diffuse colours.
AMBIENT, HEADLIGHT, LAMP, FLOOR = 0.1, 0.2, 0.4, (1.0, 0.5, 0.2)


def assert_floor_is(sensor: CameraSensor, *colors: Any) -> None:
  expected = 255.0 * torch.tensor(np.array(colors), dtype=torch.float32)
  seen = sensor.data.rgb
  assert seen is not None
  assert (seen.flatten(2) == seen[:, :, :1, 0]).all()
  torch.testing.assert_close(seen[:, :, 0, 0].float(), expected, rtol=0.0, atol=1.0)


@pytest.mark.parametrize("engine", ENGINES)
def test_colours_materials_and_lights_are_those_of_each_world(engine: str) -> None:
  sim, (sensor,) = build(eye(), engine=engine)
  model, floor = sim.mj_model, sim.mj_model.geom("floor").id
  over_the_floor(sim)
  base, light = np.array(FLOOR), AMBIENT + HEADLIGHT + LAMP
  assert_floor_is(sensor, *[light * base] * 3)
  # A write to a field that worlds share reaches all of them.
  sim.model.geom_rgba[:, floor, 0] = 0.5
  assert_floor_is(sensor, *[light * base * (0.5, 1, 1)] * 3)
  sim.expand_model_fields(
    ["geom_rgba", "geom_matid", "light_diffuse", "light_active", "light_type", "light_attenuation"]
  )
  sim.model.geom_rgba[:, floor, 0] = torch.tensor([1.0, 0.2, 0.0], dtype=sim.model.geom_rgba.dtype)
  colors = np.stack([base * (1, 1, 1), base * (0.2, 1, 1), base * (0, 1, 1)])
  assert_floor_is(sensor, *light * colors)
  sim.model.light_diffuse[0, 0] = torch.tensor([0.0, 0.4, 0.7])
  sim.model.light_active[1, 0] = False
  lights = np.array([[0.3, 0.7, 1.0], [0.3] * 3, [0.7] * 3])
  assert_floor_is(sensor, *lights * colors)
  # What no light of the compiled model has: attenuation, and a cone. From so high above, light falls straight down.
  sim.model.light_active[1, 0] = True
  sim.model.light_type[1:, 0] = torch.tensor([mujoco.mjtLightType.mjLIGHT_POINT.value, 0], dtype=torch.int32)
  sim.model.light_attenuation[1, 0] = torch.tensor([2.0, 0.0, 0.0])
  sim.model.light_pos[:, 0] = torch.tensor([2.5, 2.5, 1e4], dtype=sim.dtype)
  lights[1], lights[2] = 0.3 + 0.4 / 2, 0.7
  assert_floor_is(sensor, *lights * colors)
  sim.model.light_pos[:, 0] = torch.tensor([1e4, 0.0, 1e4], dtype=sim.dtype)  # The cone points elsewhere.
  lights[1], lights[2] = 0.3 + 0.4 / 2 * np.sqrt(0.5), 0.3
  assert_floor_is(sensor, *lights * colors)
  # A texture per world, by its material; a colour of one's own is mixed with it.
  sim.model.geom_matid[:, floor] = torch.tensor([model.material(name).id for name in ("red", "blue", "red")])
  sim.model.geom_rgba[:2, floor] = 0.5
  sim.model.geom_rgba[:2, floor, 3] = 1.0
  assert_floor_is(sensor, lights[0] * (1, 0, 0), lights[1] * (0, 0, 1), lights[2] * colors[2] * (1, 0, 0))
  sim.expand_model_fields(["mat_texid"])
  sim.model.mat_texid[0, model.material("red").id, mujoco.mjtTextureRole.mjTEXROLE_RGB.value] = model.texture("blue").id
  assert_floor_is(sensor, lights[0] * (0, 0, 1), lights[1] * (0, 0, 1), lights[2] * colors[2] * (1, 0, 0))


@pytest.mark.parametrize("engine", ENGINES)
def test_every_field_that_colours_depend_on_may_differ_between_worlds(engine: str) -> None:
  sim, (sensor,) = build(eye(use_shadows=True), engine=engine)
  place(sim, *[(0.3, 0.1, 1.5, None)] * NUM_ENVS)
  model = sim.mj_model
  tiles = model.material("tiles").id
  # The lamp becomes a spot light over a floor of tiles, on which the box casts its shadow.
  start: dict[str, Any] = {"light_type": 0, "light_pos": (0.5, 0.3, 3.0), "light_cutoff": 30.0, "light_exponent": 1.0}
  own: dict[str, Any] = {
    "light_ambient": 0.2,
    "light_specular": 0.9,
    "light_exponent": 40.0,
    "light_cutoff": 10.0,
    "light_castshadow": False,
    "light_dir": (0.1, 0.1, -0.99),
    "mat_emission": 0.4,
    "mat_specular": 0.9,
    "mat_shininess": 0.05,
    "mat_rgba": 0.4,
    "mat_texrepeat": 3.0,
    "mat_texuniform": True,
  }
  sim.expand_model_fields([*start, *own, "geom_matid", "geom_rgba"])
  sim.model.geom_matid[:, model.geom("floor").id] = tiles
  sim.model.geom_rgba[:, model.geom("floor").id] = torch.tensor([0.5, 0.5, 0.5, 1.0])  # Leaves it to the material.
  sim.model.light_specular[:] = 0.5
  for name, value in start.items():
    sim.model[name][:, 0] = torch.as_tensor(value, dtype=sim.model[name].dtype)
  before = sensor.data.rgb.clone()
  for name, value in own.items():
    element = tiles if name.startswith("mat_") else 0
    sim.model[name][1, element] = torch.as_tensor(value, dtype=sim.model[name].dtype)
    seen = sensor.data.rgb.clone()
    assert not torch.equal(seen[1], before[1]), name
    assert torch.equal(seen[::2], before[::2]), name
    if name in ("light_exponent", "light_cutoff"):
      # Back to a light that shows what comes next.
      sim.model[name][1, 0] = start[name]
      seen = sensor.data.rgb.clone()
    before = seen


@pytest.mark.parametrize("engine", ENGINES)
def test_cameras_and_shapes_are_those_of_each_world(engine: str) -> None:
  sim, (sensor,) = build(eye(data_types=("depth", "distance", "segmentation")), engine=engine)
  over_the_floor(sim)
  number, ball = sim.mj_model.camera("robot/eye").id, sim.mj_model.geom("ball").id
  sim.model.cam_fovy[:, number] = 90.0
  corner = torch.full((3,), np.sqrt(1 + (7 / 8) ** 2 + (11 / 8) ** 2), dtype=torch.float32)
  torch.testing.assert_close(sensor.data.distance[:, 0, 0, 0], corner)
  sim.expand_model_fields(["cam_pos", "cam_quat", "cam_fovy", "geom_size"])
  sim.model.cam_fovy[1, number] = 60.0
  sim.model.cam_pos[:, number, 2] = torch.tensor([0.0, -0.3, -0.4], dtype=sim.dtype)
  torch.testing.assert_close(sensor.data.depth[:, 0, 4, 6], torch.tensor([1.0, 0.7, 0.6]))
  corner[1] = 0.7 * np.sqrt(1 + (7**2 + 11**2) / 64 * np.tan(np.pi / 6) ** 2)
  corner[2] *= 0.6
  torch.testing.assert_close(sensor.data.distance[:, 0, 0, 0], corner)
  torch.testing.assert_close(sensor.data.pos_w[:, 2].float(), torch.tensor([1.0, 0.7, 0.6]))
  flip = torch.tensor([0.0, 1.0, 0.0, 0.0], dtype=sim.dtype)
  sim.model.cam_quat[2, number] = flip
  assert (sensor.data.depth[2] == -1).all()
  assert (sensor.data.distance[2] == -1).all()
  assert (sensor.data.segmentation[2] == -1).all()
  torch.testing.assert_close(sensor.data.quat_w[2].abs(), flip, atol=1e-6, rtol=0.0)
  # The tree of geoms follows their sizes.
  place(sim, *[(-0.6, 0.2, 2.0, None)] * NUM_ENVS)
  sim.model.cam_quat[2, number] = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=sim.dtype)
  sim.model.cam_pos[:, number] = 0.0
  sim.model.cam_fovy[:, number] = 2.0
  sim.model.geom_size[:, ball, 0] = torch.tensor([0.2, 0.7, 1.1], dtype=sim.dtype)
  torch.testing.assert_close(sensor.data.depth.amin((1, 2, 3)), torch.tensor([1.5, 1.0, 0.6]), atol=1e-3, rtol=0.0)
  # So does it where geoms are that never move by themselves.
  sim.expand_model_fields(["geom_pos"])
  sim.model.geom_pos[:, ball, 2] += torch.tensor([0.0, 0.1, 0.3], dtype=sim.dtype)
  torch.testing.assert_close(sensor.data.depth.amin((1, 2, 3)), torch.tensor([1.5, 0.9, 0.3]), atol=1e-3, rtol=0.0)


def test_images_are_drawn_when_first_asked_for_and_once_a_state(
  monkeypatch: pytest.MonkeyPatch, count_operations: Count
) -> None:
  drawn, built = [], []
  draw, build_context = mujoco_warp.render, mujoco_warp.create_render_context
  monkeypatch.setattr(mujoco_warp, "render", lambda *args: drawn.append(draw(*args)))

  def counted(*args: Any, **options: Any) -> Any:
    built.append(args)
    return build_context(*args, **options)

  monkeypatch.setattr(mujoco_warp, "create_render_context", counted)
  sim, (sensor,) = build(eye(data_types=("depth", "rgb")))
  over_the_floor(sim)
  held = sensor.data
  assert depth_is(sensor)
  assert len(drawn) == 1
  assert count_operations(lambda: sensor.data) == 0
  sim.data.qpos[0, 2] += 0.5
  for _ in range(3):
    advance(sim, [sensor])
  assert len(drawn) == 1
  assert depth_is(sensor, 1.5, 1.0, 1.0)
  assert len(drawn) == 2
  assert sensor.data.depth.data_ptr() == held.depth.data_ptr()
  sim.reset(torch.tensor([True, False, False]))
  sim.data.qpos[0, :2] = 2.5
  torch.testing.assert_close(sensor.data.depth[:, 0, 4, 6], torch.tensor([2.0, 1.0, 1.0]))
  assert sensor.state_dict() == {}
  sim.expand_model_fields(["geom_rgba", "cam_fovy"])
  _ = sensor.data
  assert len(built) == 1


def test_sensors_on_one_camera_keep_to_themselves() -> None:
  both: Any = ("rgb", "segmentation")
  sensors = [
    eye(data_types=both),
    eye(name="small", data_types=("depth",), width=5, height=3),
    eye(name="hidden", data_types=both, geom_groups=(0, 4)),
    eye(name="shaded", use_shadows=True),
    eye(name="bare", use_textures=False),
  ]
  rays = RayCastSensorCfg(frames=FrameMatch(type="camera", pattern="robot/eye"), geom_groups=(3,))
  sim, (only,) = build(eye(data_types=both))
  together, (plain, small, hidden, shaded, bare, _) = build(*sensors, rays)
  for each in (sim, together):
    place(each, *[(0.3, 0.1, 1.5, None)] * NUM_ENVS)
    each.model.geom_matid[:, each.mj_model.geom("floor").id] = 0
  # A new sensor may come after images were drawn, and changes nothing for those that are there.
  before = plain.data.rgb.clone()
  late: Any = eye(name="late", data_types=("depth",)).build()
  late.initialize(together, {})
  together.data.qpos[0, 0] += 0.1
  sim.data.qpos[0, 0] += 0.1
  assert not torch.equal(plain.data.rgb[0], before[0])
  for kind in both:
    assert torch.equal(getattr(plain.data, kind), getattr(only.data, kind))
  assert late.data.depth.shape == (NUM_ENVS, 1, 8, 12)
  assert small.data.depth.shape == (NUM_ENVS, 1, 3, 5)
  geom = together.mj_model.geom
  assert geom("hidden").id in hidden.data.segmentation[:, 0]
  assert geom("hidden").id not in plain.data.segmentation[:, 0]
  darker = shaded.data.rgb.int() - plain.data.rgb.int()
  assert darker.max() == 0
  assert darker.min() < -20
  floor = plain.data.segmentation[:, 0] == geom("floor").id
  assert (plain.data.rgb[:, 1][floor] == 0).all()
  assert (bare.data.rgb[:, 1][floor] > 0).all()


def test_an_image_is_held_for_its_period_in_each_world() -> None:
  sim, (live, slow) = build(eye(data_types=ALL), eye(name="slow", data_types=ALL, update_period=3))
  over_the_floor(sim)

  def frame(sensor: CameraSensor, world: int) -> dict[str, torch.Tensor]:
    return {name: value[world].clone() for name, value in vars(sensor.data).items()}

  def expect(kept: list[dict[str, torch.Tensor]], now: list[bool]) -> None:
    for world, (held, is_new) in enumerate(zip(kept, now, strict=True)):
      if is_new:
        held.update(frame(live, world))
      for name, value in frame(slow, world).items():
        assert torch.equal(value, held[name]), (name, world)

  kept: list[dict[str, torch.Tensor]] = [{}, {}, {}]
  # Before the first step every state is a beginning, whichever was read.
  for _ in range(2):
    sim.data.qpos[:, 2] += 0.1
    expect(kept, [True] * 3)
  due = {3: [True] * 3, 6: [True] * 3, 7: [False, True, False], 9: [True, False, True], 10: [False, True, False]}
  mask = torch.tensor([False, True, False])
  for number in range(1, 11):
    advance(sim, [live, slow])
    sim.data.qpos[:, 2] += 0.1
    if number == 7:
      expect(kept, [False] * 3)
      slow.reset(mask)
      expect(kept, due[number])
      sim.data.qpos[1, 0] += 0.2  # Still being put into its initial state.
    expect(kept, due.get(number, [False] * 3))
  # The image was not read when it was due: the next reading shows the present state, and the rhythm stays.
  for _ in range(6):
    advance(sim, [live, slow])
    sim.data.qpos[:, 2] += 0.1
  expect(kept, [True, True, True])
  for _ in range(2):
    advance(sim, [live, slow])
    sim.data.qpos[:, 2] += 0.1
  expect(kept, [True, False, True])


def test_worlds_that_hold_their_image_are_not_rendered(monkeypatch: pytest.MonkeyPatch) -> None:
  looked_at: list[np.ndarray] = []
  draw = mujoco_warp.render

  def spy(m: Any, d: Any, context: Any) -> None:
    draw(m, d, context)
    looked_at.append(context.depth_data.numpy().any(axis=1))

  monkeypatch.setattr(mujoco_warp, "render", spy)
  sim, (slow,) = build(eye(data_types=("depth",), update_period=100))
  over_the_floor(sim)
  assert depth_is(slow)
  advance(sim, [slow])
  slow.reset(torch.tensor([False, True, False]))
  assert depth_is(slow)
  advance(sim, [slow])
  assert depth_is(slow)
  assert [rows.tolist() for rows in looked_at] == [[True] * 3, [False, True, False]]


def test_a_world_that_was_reset_is_drawn_though_nothing_moved() -> None:
  sim, (live, slow) = build(eye(data_types=ALL), eye(name="slow", data_types=ALL, update_period=100))
  over_the_floor(sim)
  held = slow.data.pos_w.clone()
  advance(sim, [live, slow])
  sim.data.qpos[:, 2] += 0.1
  assert torch.equal(slow.data.pos_w, held)
  slow.reset(torch.tensor([False, True, False]))
  assert torch.equal(slow.data.pos_w[1], live.data.pos_w[1])
  assert torch.equal(slow.data.pos_w[::2], held[::2])


def test_a_held_image_is_saved_and_gone_on_from() -> None:
  slow = eye(data_types=ALL, update_period=4)
  (sim, (sensor,)), (other_sim, (other,)) = build(slow), build(slow)

  def look(sim: Simulation, sensor: CameraSensor) -> list[torch.Tensor]:
    advance(sim, [sensor])
    sim.data.qpos[:, 2] += 0.1
    return [value.clone() for value in vars(sensor.data).values()]

  over_the_floor(sim)
  for _ in range(6):
    look(sim, sensor)
  other_sim.load_state_dict(sim.state_dict())
  other.load_state_dict(sensor.state_dict())
  for _ in range(5):
    for a, b in zip(look(sim, sensor), look(other_sim, other), strict=True):
      assert torch.equal(a, b)


def drive(sim: Simulation, *sensors: CameraSensor) -> list[torch.Tensor]:
  """Steps with writes, resets, model writes and an expansion in between; what was read in each."""
  read: list[torch.Tensor] = []
  over_the_floor(sim)
  floor = sim.mj_model.geom("floor").id
  for number in range(12):
    advance(sim, sensors)
    sim.data.qpos[:, :2] -= 0.1
    if number == 4:
      mask = torch.tensor([True, False, True], device=sim.device)
      sim.reset(mask)
      for sensor in sensors:
        sensor.reset(mask)
    if number == 7:
      sim.model.geom_rgba[:, floor, 0] = 0.3
    if number == 9:
      sim.expand_model_fields(["geom_rgba"])
      sim.model.geom_rgba[1, floor, 1] = 0.1
    for sensor in sensors:
      read += [value.clone() for value in vars(sensor.data).values()]
  return read


def test_captured_images_are_bit_equal_to_eager_ones() -> None:
  cfgs = [eye(name=f"eye{period}", data_types=ALL, update_period=period) for period in (0, 3)]
  captured, eager = (build(*cfgs, engine="warp", capture=capture) for capture in (True, False))
  for a, b in zip(drive(captured[0], *captured[1]), drive(eager[0], *eager[1]), strict=True):
    assert torch.equal(a, b)


@pytest.mark.parametrize("period", [0, 3])
def test_a_world_that_diverges_changes_no_image_of_others(period: int) -> None:
  sim, (sensor,) = build(eye(data_types=ALL, update_period=period))
  scatter(sim)
  before = {name: value.clone() for name, value in vars(sensor.data).items()}
  sim.data.qpos[1, :3] = torch.nan
  for name, value in vars(sensor.data).items():
    assert torch.equal(value[::2], before[name][::2]), name


def test_a_new_camera_is_added_where_it_is_wanted() -> None:
  down: Any = {"data_types": ("depth", "segmentation")}
  sim, (fixed, carried, flat) = build(
    cfg("fixed", pos=(2.5, 2.5, 3.0), fovy=10.0, **down),
    cfg("carried", body="robot/base", pos=(0, 0, 0.2), quat=(0.0, 1.0, 0.0, 0.0), **down),
    cfg("flat", pos=(2.5, 2.5, 3.0), orthographic=True, fovy=0.4, **down),
  )
  place(sim, (2.5, 2.5, 1.0, None), (0, 0, 1, Rotation.from_euler("x", 180, degrees=True)), (2.5, 2.5, 2.0, None))
  shell = sim.mj_model.geom("shell").id
  assert fixed.intrinsic_matrix[0, 1, 1].item() == pytest.approx(4 / np.tan(np.pi / 36))
  assert shell in fixed.data.segmentation[0, 0]
  # 0.4 m are eight rows, so that the shell's 0.1 m are the four pixels around the middle, however far it is.
  assert (flat.data.segmentation[::2, 0] == shell).sum((1, 2)).tolist() == [4, 4]
  assert (carried.data.segmentation[0, 0] == -1).all()
  assert sim.mj_model.geom("floor").id in carried.data.segmentation[1, 0]
  assert carried.data.pos_w[1].tolist() == pytest.approx([0, 0, 0.8])
  with pytest.raises(ValueError, match="CameraSensorCfg 'flat': camera 'flat' is orthographic"):
    _ = flat.intrinsic_matrix


def test_an_existing_camera_is_seen_with_another_field_of_view() -> None:
  shown: Any = ("depth", "segmentation")
  sim, (narrow, wide, _) = build(eye(data_types=shown), eye("wide", fovy=90.0, data_types=shown), cfg("third"))
  place(sim, *[(0.6, 0.0, 1.5, None)] * NUM_ENVS)
  model = sim.mj_model
  assert (model.cam("wide").fovy, model.cam("robot/eye").fovy) == (90.0, 60.0)
  for field in ("pos", "quat", "mode", "bodyid"):
    np.testing.assert_array_equal(getattr(model.cam("wide"), field), getattr(model.cam("robot/eye"), field))
  for field in ("pos_w", "mat_w"):
    torch.testing.assert_close(getattr(narrow.data, field), getattr(wide.data, field))
  # The box fills less of the wide view, and the middle of both is one point of it.
  shares = [(sensor.data.segmentation[:, 0] == model.geom("box").id).float().mean() for sensor in (narrow, wide)]
  assert shares[0] > 1.3 * shares[1] > 0.0
  torch.testing.assert_close(narrow.data.depth[:, 0, 4, 6], wide.data.depth[:, 0, 4, 6], rtol=0.0, atol=1e-6)


def test_options_that_only_physics_needs_do_not_keep_a_model_from_being_drawn() -> None:
  xml = SCENE.replace("<option ", '<option solver="PGS" integrator="RK4" ')
  sim, (sensor,) = build(eye(data_types=("depth",)), xml=xml)
  over_the_floor(sim)
  assert depth_is(sensor)


def test_documented_shapes_are_the_real_ones() -> None:
  sim, (sensor,) = build(eye(data_types=ALL))
  sizes = {"num_envs": NUM_ENVS, **SIZE}
  kinds = {"rgb": torch.uint8, "segmentation": torch.int32, "pos_w": sim.dtype, "mat_w": sim.dtype, "quat_w": sim.dtype}
  names = [field.name for field in dataclasses.fields(CameraData)]
  names += [name for name, member in vars(CameraData).items() if isinstance(member, property)]
  assert len(names) == 8
  for name in names:
    (shape,) = re.findall(r"\((num_envs[^()]*)\)", documentation(CameraData, name))
    expected = tuple(sizes.get(size) or int(size) for size in re.split(r",\s*", shape))
    value = getattr(sensor.data, name)
    assert tuple(value.shape) == expected, name
    assert value.dtype == kinds.get(name, torch.float32), name
  torch.testing.assert_close(sensor.data.rgb_float * 255.0, sensor.data.rgb.float())


def test_images_of_other_data_types_are_none() -> None:
  _, (sensor,) = build(eye(data_types=("depth",)))
  images = sensor.data
  assert images.rgb is images.rgb_float is images.distance is images.segmentation is None


def test_a_model_that_cannot_be_drawn_says_so() -> None:
  xml = SCENE.replace("<freejoint/>", '<joint name="slide" type="slide"/>').replace(
    "</mujoco>", '<actuator><pid joint="slide" kp="1"/></actuator></mujoco>'
  )
  with pytest.raises(MjlabError, match="MuJoCo Warp, which draws images on a CPU too, cannot take this model"):
    build(eye(), xml=xml)


@needs_gpu
def test_a_recorded_step_draws_what_an_eager_one_does() -> None:
  cfgs = [eye(name=f"eye{period}", data_types=ALL, update_period=period) for period in (0, 3)]

  def run(capture: bool) -> list[torch.Tensor]:
    sim, sensors = build(*cfgs, engine="auto", device="cuda", capture=capture)
    over_the_floor(sim)
    count = torch.zeros(NUM_ENVS, dtype=torch.int64, device=sim.device)
    period = torch.tensor([4, 5, 7], device=sim.device)
    seen = [torch.zeros_like(value) for sensor in sensors for value in vars(sensor.data).values()]

    def body() -> None:
      advance(sim, sensors)
      sim.data.qpos[:, :2] -= 0.1
      count.add_(1)
      mask = count % period == 0
      sim.reset(mask)
      for sensor in sensors:
        sensor.reset(mask)
      for target, value in zip(seen, [v for sensor in sensors for v in vars(sensor.data).values()], strict=True):
        target.copy_(value)

    graph, read = sim.capture(body), []
    for _ in range(20):
      graph()
      read += [value.cpu() for value in seen]
    assert graph.num_graphs == (1 if capture else 0)
    return read

  for a, b in zip(run(True), run(False), strict=True):
    assert torch.equal(a, b)


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_camera_draws_what_its_image_spans(orthographic: bool) -> None:
  fovy = 0.4 if orthographic else 60.0
  # It looks straight down, with y up in its image.
  sim, (sensor,) = build(cfg("down", body="robot/base", orthographic=orthographic, fovy=fovy))
  place(sim, *[(x, 0.0, 3.0, None) for x in (0.0, 1.0, 2.0)])
  draw: Any = Sketch()
  sensor.debug_draw(draw)
  ((position, *_),) = draw.shapes["frames"]
  ((start, end, *_),) = draw.shapes["lines"]
  start, end = start.unflatten(0, (2, 8)), end.unflatten(0, (2, 8))
  torch.testing.assert_close(position, sim.data.cam_xpos[[2, 0], sensor._camera])
  corners = end[:, :4] - position[:, None]
  length = -corners[0, 0, 2]
  assert length > 0.1
  half = 0.2 if orthographic else length * np.tan(np.radians(30.0))
  across = half * 12 / 8
  expected = [(-across, half), (across, half), (across, -half), (-across, -half)]
  torch.testing.assert_close(corners[..., :2], torch.tensor([expected] * 2, dtype=sim.dtype))
  spread = (start[:, :4] - position[:, None]).norm(dim=-1)
  assert bool((spread > 0.2).all()) == orthographic
  # And around.
  assert torch.equal(start[:, 4:], end[:, :4])
  assert torch.equal(end[:, 4:], end[:, :4].roll(-1, dims=1))
