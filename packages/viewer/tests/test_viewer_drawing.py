"""Drawings of shapes, from NumPy and torch, up to thousands."""

import mujoco
import numpy as np
import pytest
import torch
from mjlab_core import DebugDraw
from mjlab_viewer import CameraCfg, DrawList, OffscreenRenderer, PictureCfg, SnapshotTaker
from mjlab_viewer.drawing.mjv import add_to_scene, count_geoms, thinned
from viewer_env import BOX, BoxEnv

MODEL = mujoco.MjModel.from_xml_string(BOX)
RED = (1.0, 0.0, 0.0, 1.0)
UPRIGHT = np.array([[1.0, 0.0, 0.0, 0.0]])


def finished(draw: DrawList) -> DrawList:
  draw.finish(iter([tensor.numpy() for tensor in draw.pending]))
  return draw


def geoms(draw: DrawList, maxgeom: int = 100) -> list[mujoco.MjvGeom]:
  scene = mujoco.MjvScene(MODEL, maxgeom=maxgeom)
  add_to_scene(scene, MODEL, finished(draw).shapes)
  return list(scene.geoms[: scene.ngeom])


@pytest.mark.parametrize("make", [np.array, torch.tensor])
def test_an_arrow_begins_at_its_start_and_points_at_its_end(make) -> None:
  draw: DebugDraw = DrawList((3, 1))
  assert tuple(draw.worlds) == (3, 1)
  draw.arrows(make([[1.0, 2.0, 3.0]]), make([[1.0, 2.0, 5.0]]), RED, 0.1)
  (arrow,) = geoms(draw)
  assert arrow.type == mujoco.mjtGeom.mjGEOM_ARROW
  np.testing.assert_allclose(arrow.pos, [1, 2, 3], atol=1e-6)
  np.testing.assert_allclose(arrow.mat[:, 2], [0, 0, 1], atol=1e-6)
  assert arrow.size[2] == pytest.approx(2.0)
  np.testing.assert_allclose(arrow.rgba, RED)


def test_shapes_of_one_call_differ_in_colour_and_size() -> None:
  draw = DrawList()
  colors = torch.tensor([[1.0, 0.0, 0.0, 0.25], [0.0, 1.0, 0.0, 0.5], [0.0, 0.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]])
  draw.spheres(torch.zeros(4, 3), torch.tensor([0.1, 0.2, 0.3, 0.4]), colors)
  drawn = geoms(draw)
  np.testing.assert_allclose([geom.rgba for geom in drawn], colors)
  np.testing.assert_allclose([geom.size for geom in drawn], np.array([[0.1, 0.2, 0.3, 0.4]]).T.repeat(3, 1), rtol=1e-6)


def test_a_frame_shows_the_columns_of_its_rotation() -> None:
  quaternion = np.array([0.5, -0.3, 0.7, 0.4])
  quaternion /= np.linalg.norm(quaternion)
  draw = DrawList()
  draw.frames(torch.tensor([[1.0, 0.0, 0.0]]), torch.tensor(quaternion)[None], 0.5)
  matrix = np.zeros(9)
  mujoco.mju_quat2Mat(matrix, quaternion)
  drawn = geoms(draw)
  assert len(drawn) == 3
  for axis, geom in enumerate(drawn):
    column = matrix.reshape(3, 3)[:, axis]
    np.testing.assert_allclose(geom.pos, [1, 0, 0] + 0.25 * column, atol=1e-6)
    np.testing.assert_allclose(geom.mat[:, 2], column, atol=1e-6)
    assert geom.rgba[axis] == max(geom.rgba[:3])


def test_ellipsoids_and_ghosts_take_pose_and_mesh() -> None:
  turned = np.array([[0.0, 1.0, 0.0, 0.0]])
  draw = DrawList()
  draw.ellipsoids(np.array([[0.0, 0.0, 1.0]]), turned, np.array([[0.1, 0.2, 0.3]]), RED)
  draw.meshes("spike", np.array([[4.0, 5.0, 6.0]]), turned, (1.0, 1.0, 1.0, 0.4))
  ellipsoid, ghost = geoms(draw)
  np.testing.assert_allclose(ellipsoid.size, [0.1, 0.2, 0.3], rtol=1e-6)
  np.testing.assert_allclose(ghost.mat, np.diag([1.0, -1.0, -1.0]), atol=1e-6)
  np.testing.assert_allclose(ghost.pos, [4, 5, 6])
  assert ghost.dataid == 2 * MODEL.mesh("spike").id


def test_a_mesh_that_the_model_lacks_and_rows_of_nan_are_left_out() -> None:
  draw = DrawList()
  draw.meshes("no such mesh", np.zeros((1, 3)), UPRIGHT, RED)
  draw.spheres(torch.tensor([[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]]), 0.1, RED)
  draw.lines(np.zeros((0, 3)), np.zeros((0, 3)), RED, 0.1)
  assert len(geoms(draw)) == 1


@pytest.mark.parametrize(
  ("room", "kept"), [(1000, (70, 7, 300)), (377, (70, 7, 300)), (100, (18, 2, 80)), (0, (0, 0, 0)), (-5, (0, 0, 0))]
)
def test_without_room_for_all_shapes_some_are_left_out_evenly(room: int, kept: tuple[int, ...]) -> None:
  draw = DrawList()
  along = np.arange(300.0)[:, None] * [[0.01, 0.0, 0.0]]
  draw.spheres(along[:70], 0.1, RED)
  draw.arrows(along[:7], along[:7] + 1.0, RED, 0.1)
  draw.spheres(along, 0.1, RED)
  shown = thinned(finished(draw).shapes, room)
  assert [len(shapes) for shapes in shown] == list(kept)
  if room == 100:
    assert count_geoms(shown) == 100
    steps = np.diff(shown[2].position[:, 0])
    assert steps.min() > 0.029
    assert steps.max() < 0.041


def test_thousands_of_shapes_grow_the_picture_instead_of_failing(opengl: None) -> None:
  env = BoxEnv(1)
  places = torch.rand(5000, 3) * torch.tensor([2.0, 2.0, 0.0]) - torch.tensor([1.0, 1.0, -0.1])
  env.command.debug_draw = lambda draw: draw.spheres(places, 0.1, (0.0, 1.0, 0.0, 1.0))
  taker = SnapshotTaker(env)
  with OffscreenRenderer(
    env.sim.mj_model, PictureCfg(width=64, height=48, camera=CameraCfg(elevation=-60))
  ) as renderer:
    before = renderer.render(taker.take((0,))).astype(int)
    after = renderer.render(taker.take((0,), drawers=("command speed",))).astype(int)
  assert np.median(after[..., 1] - after[..., 0]) > 20 + np.median(before[..., 1] - before[..., 0])
