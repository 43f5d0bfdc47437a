"""The camera of pictures, page and window."""

import mujoco
import numpy as np
import pytest
from mjlab_core import MjlabError
from mjlab_viewer import BrowserViewer, CameraCfg, OffscreenRenderer, PictureCfg, SnapshotTaker
from viewer_env import BOX, BoxEnv

MODEL = mujoco.MjModel.from_xml_string(BOX)


def eye_of_mujoco(cfg: CameraCfg, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
  """Return position and direction of the eye in MuJoCo, for the same configuration."""
  camera, scene = mujoco.MjvCamera(), mujoco.MjvScene(MODEL, maxgeom=100)
  resolved = cfg.resolve(MODEL)
  resolved.aim(camera, resolved.target(data.xpos))
  option = mujoco.MjvOption()
  mujoco.mjv_updateScene(MODEL, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
  # A scene has an eye for the left and for the right.
  eyes = scene.camera
  return (eyes[0].pos + eyes[1].pos) / 2, np.array(eyes[0].forward)


@pytest.mark.parametrize(
  "cfg",
  [CameraCfg(), CameraCfg(distance=3.0, azimuth=90.0, elevation=-45.0), CameraCfg(lookat=(1.0, 2.0, 0.5))],
)
def test_the_eye_is_where_mujocos_angles_put_it(cfg: CameraCfg) -> None:
  data = mujoco.MjData(MODEL)
  data.qpos[:3] = [0.4, -0.3, 0.7]
  mujoco.mj_forward(MODEL, data)
  position, forward = eye_of_mujoco(cfg, data)
  camera = cfg.resolve(MODEL)
  target = camera.target(data.xpos)
  np.testing.assert_allclose(target + camera.offset, position, atol=1e-5)
  np.testing.assert_allclose(-camera.offset / np.linalg.norm(camera.offset), forward, atol=1e-5)
  if cfg.lookat is None:
    np.testing.assert_allclose(target, data.xpos[1])


def test_a_negative_elevation_looks_down_from_above_in_the_browser_too() -> None:
  cfg = CameraCfg(distance=2.0, azimuth=90.0, elevation=-45.0)
  with BrowserViewer(BoxEnv(1), camera=cfg, port=8300) as viewer:
    camera = viewer.server.initial_camera
    # The robot is kept at the page's origin.
    np.testing.assert_allclose(camera.look_at, [0, 0, 0])
    np.testing.assert_allclose(camera.position, [0, -2 * np.sqrt(0.5), 2 * np.sqrt(0.5)], atol=1e-9)
    assert camera.fov == pytest.approx(np.deg2rad(MODEL.vis.global_.fovy))


def test_pictures_browser_and_window_begin_with_the_same_view(opengl: None) -> None:
  env = BoxEnv(1)
  with OffscreenRenderer(env.sim.mj_model, PictureCfg(width=32, height=24)) as renderer:
    renderer.render(SnapshotTaker(env).take((0,)))
    aimed = renderer._camera
    offset = CameraCfg().resolve(env.sim.mj_model).offset
    with BrowserViewer(env, port=8300) as viewer:
      np.testing.assert_allclose(viewer.server.initial_camera.position, offset)
    assert aimed.distance == pytest.approx(np.linalg.norm(offset))
    np.testing.assert_allclose(aimed.lookat, env.sim.datas[0].xpos[1])


def test_the_camera_looks_at_the_centre_of_a_model_without_moving_bodies() -> None:
  model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1' pos='3 0 0'/></worldbody></mujoco>")
  np.testing.assert_allclose(CameraCfg().resolve(model).target(np.zeros((1, 3))), model.stat.center)


def test_the_camera_looks_above_the_fixed_base_of_a_robot() -> None:
  model: mujoco.MjModel = mujoco.MjModel.from_xml_string("""
    <mujoco><statistic extent="2"/><worldbody>
      <body name="base" mocap="true"><body name="arm"><joint/><geom size=".1"/></body></body>
    </worldbody></mujoco>""")
  at = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 0.2, 0.3]])
  np.testing.assert_allclose(CameraCfg().resolve(model).target(at), [3.0, 0.0, 0.5])
  np.testing.assert_allclose(CameraCfg(body="base").resolve(model).target(at), [3.0, 0.0, 0.0])
  env = BoxEnv(1)
  env.sim.mj_model = model
  env.sim.datas = [mujoco.MjData(model)]
  env.sim.data._datas = env.sim.datas
  with BrowserViewer(env, port=8300) as viewer:
    np.testing.assert_allclose(viewer.server.initial_camera.look_at, [0, 0, 0.5])


def test_an_unknown_body_is_refused_with_the_known_ones() -> None:
  with pytest.raises(MjlabError, match=r"body 'leg' does not exist\. All 2: world, box"):
    CameraCfg(body="leg").resolve(MODEL)
