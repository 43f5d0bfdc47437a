"""Pictures and films of worlds, without a screen."""

import errno
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Literal, NoReturn

import av
import mujoco
import numpy as np
import pytest
import torch
from mjlab_core import RenderingError
from mjlab_viewer import BackgroundVideo, CameraCfg, OffscreenRenderer, PictureCfg, Replay, TrainingVideo, VideoFile
from mjlab_viewer.pictures.offscreen import tiles
from mjlab_viewer.snapshot import Snapshot, SnapshotTaker
from viewer_env import GROUND, BoxEnv

SMALL = PictureCfg(width=96, height=72, shadows=False)


def red(picture: np.ndarray) -> np.ndarray:
  """Return the pixels of the red box, bool (height, width)."""
  image = picture.astype(int)
  return (image[..., 0] > 60) & (image[..., 0] > 2 * image[..., 1]) & (image[..., 0] > 2 * image[..., 2])


def middle(mask: np.ndarray) -> np.ndarray:
  rows, columns = np.nonzero(mask)
  return np.array([columns.mean() / mask.shape[1], rows.mean() / mask.shape[0]])


def test_the_camera_follows_the_robot_of_each_world(opengl: None) -> None:
  env = BoxEnv(4)
  taker = SnapshotTaker(env)
  with OffscreenRenderer(env.sim.mj_model, SMALL) as renderer:
    for world in range(4):
      picture = renderer.render(taker.take((world,)))
      assert picture.shape == (72, 96, 3)
      np.testing.assert_allclose(middle(red(picture)), [0.5, 0.5], atol=0.06)


def test_every_world_has_a_tile(opengl: None) -> None:
  env = BoxEnv(4)
  with OffscreenRenderer(env.sim.mj_model, SMALL) as renderer:
    picture = red(renderer.render(SnapshotTaker(env).take((0, 1, 2, 3))))
  for rows in (slice(0, 36), slice(36, 72)):
    for columns in (slice(0, 48), slice(48, 96)):
      np.testing.assert_allclose(middle(picture[rows, columns]), [0.5, 0.5], atol=0.08)


@pytest.mark.parametrize("count", [1, 2, 3, 5, 9])
def test_tiles_fill_the_picture_in_reading_order_and_do_not_overlap(count: int) -> None:
  painted = np.zeros((51, 67), dtype=int)
  for number, (left, bottom, width, height) in enumerate(tiles(count, 67, 51), start=1):
    assert painted[bottom : bottom + height, left : left + width].max() == 0
    painted[bottom : bottom + height, left : left + width] = number
  assert painted[-1, 0] == 1
  assert painted.max() == count
  assert (painted > 0).mean() >= count / (count + 2)


def test_colours_sizes_and_meshes_of_each_world_are_shown(opengl: None) -> None:
  env = BoxEnv(4)
  model = env.sim.mj_model
  box, ornament = model.geom("box").id, model.geom("ornament").id
  env.sim.expand("geom_rgba")[1, box] = torch.tensor([0.1, 0.1, 0.9, 1.0])
  env.sim.expand("geom_size")[2, box] *= 0.5
  env.sim.expand("geom_dataid")[3, ornament] = model.mesh("spike").id
  taker = SnapshotTaker(env)
  with OffscreenRenderer(model, SMALL) as renderer:
    first, second, third, fourth = (renderer.render(taker.take((world,))).astype(int) for world in range(4))
    again = renderer.render(taker.take((0,)))
  assert red(first).sum() > 100
  assert red(second).sum() == 0
  assert ((second[..., 2] > 60) & (second[..., 2] > 2 * second[..., 0])).sum() > 100
  assert 0 < red(third).sum() < 0.5 * red(first).sum()
  wedge, spike = ((image[..., 1] > 30 + image[..., 0]).sum() for image in (first, fourth))
  assert 0 < spike < 0.7 * wedge
  np.testing.assert_array_equal(again, first)


def test_looking_leaves_the_model_as_it_was(opengl: None) -> None:
  env = BoxEnv(2)
  env.sim.expand("geom_rgba")[1] = 0.5
  before = np.zeros(mujoco.mj_sizeModel(env.sim.mj_model), dtype=np.uint8)
  mujoco.mj_saveModel(env.sim.mj_model, None, before)
  with OffscreenRenderer(env.sim.mj_model, SMALL) as renderer:
    renderer.render(SnapshotTaker(env).take((1, 0), drawers=("command speed",)))
  after = np.zeros_like(before)
  mujoco.mj_saveModel(env.sim.mj_model, None, after)
  np.testing.assert_array_equal(before, after)


def frames(path: Path) -> list[np.ndarray]:
  with av.open(str(path)) as container:
    assert container.streams.video[0].average_rate == 50
    return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def test_a_video_holds_the_frames_given_and_appears_only_when_whole(tmp_path: Path) -> None:
  path = tmp_path / "new" / "film.mp4"
  video = VideoFile(path, 50)
  for level in (40, 120, 200):
    video.add(np.full((49, 65, 3), level, dtype=np.uint8))
    assert not path.exists()
  video.close()
  levels = [frame.mean() for frame in frames(path)]
  np.testing.assert_allclose(levels, [40, 120, 200], atol=4)
  assert frames(path)[0].shape == (48, 64, 3)
  assert [file.name for file in path.parent.iterdir()] == ["film.mp4"]


def test_a_film_that_cannot_be_written_is_named() -> None:
  # Even the superuser cannot write this folder.
  with pytest.raises(OSError, match="film"):
    VideoFile("/proc/film.mp4", 50).add(np.zeros((8, 8, 3), np.uint8))


def test_a_film_ends_where_the_disk_is_full(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
  def full(*_: object, **__: object) -> NoReturn:
    raise OSError(errno.ENOSPC, "No space left on device")

  stream = SimpleNamespace(encode=full)
  container = SimpleNamespace(add_stream=lambda *_, **__: stream, mux=full, close=full)
  monkeypatch.setattr(av, "open", lambda *_, **__: container)
  monkeypatch.setattr(Path, "unlink", full)
  video = VideoFile(tmp_path / "film.mp4", 50)
  with pytest.raises(OSError, match="No space left"):
    video.add(np.zeros((8, 8, 3), np.uint8))
  # The thread in the background waited forever here.
  video.discard()


def test_a_picture_larger_than_opengl_draws_is_refused(opengl: None) -> None:
  with pytest.raises(RenderingError, match="a picture of 999999 x 48 cannot be drawn on this machine"):
    OffscreenRenderer(BoxEnv(1).sim.mj_model, PictureCfg(width=999_999, height=48))


def test_a_film_made_in_the_background_shows_every_step(opengl: None, tmp_path: Path) -> None:
  env = BoxEnv(1)
  taker = SnapshotTaker(env)
  video = BackgroundVideo(tmp_path / "film.mp4", 50, env.sim.mj_model, SMALL)
  for _ in range(40):
    env.step(torch.zeros(1, 1))
    video.add(taker.take((0,)))
  assert video.close() == tmp_path / "film.mp4"
  assert len(frames(tmp_path / "film.mp4")) == 40


def test_without_opengl_only_the_film_fails_with_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
  monkeypatch.setenv("MUJOCO_GL", "disabled")
  env = BoxEnv(1)
  video = BackgroundVideo(tmp_path / "film.mp4", 50, env.sim.mj_model)
  snapshot = SnapshotTaker(env).take((0,))
  for _ in range(100):
    video.add(snapshot)
  assert video.close() is None
  assert isinstance(video.error, RenderingError)
  assert "\n" not in str(video.error)
  assert list(tmp_path.iterdir()) == []


def test_a_drawing_that_fails_ends_the_films_of_a_training_and_not_the_training(
  tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
  env = BoxEnv(1)
  env.draws_at_first = True
  films = TrainingVideo(env, tmp_path, interval=10, length=5, cfg=SMALL)

  def draw(draw: object) -> None:
    raise ZeroDivisionError("a drawing")

  env.command.debug_draw = draw
  for _ in range(25):
    env.step(torch.zeros(1, 1))
    films.after_step()
  films.close()
  assert films.is_off
  said = "training goes on without films: drawing: ZeroDivisionError: a drawing"
  assert [record.getMessage() for record in caplog.records] == [said]
  assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("room", [1, 32])
def test_one_thread_makes_all_films_in_full_length(
  opengl: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, room: int
) -> None:
  monkeypatch.setattr("mjlab_viewer.pictures.video._ROOM", room)
  threads: set[int] = set()
  render = OffscreenRenderer.render

  def look(self: OffscreenRenderer, snapshot: Snapshot) -> np.ndarray:
    threads.add(threading.get_ident())
    return render(self, snapshot)

  monkeypatch.setattr(OffscreenRenderer, "render", look)
  env = BoxEnv(1)
  films = TrainingVideo(env, tmp_path, interval=4, length=3, cfg=SMALL)
  for _ in range(42):
    env.step(torch.zeros(1, 1))
    films.after_step()
  films.close()
  assert not films.is_off
  assert {path.name for path in tmp_path.iterdir()} == {f"step_{step}.mp4" for step in range(0, 42, 4)}
  lengths = [len(frames(tmp_path / f"step_{step}.mp4")) for step in range(0, 42, 4)]
  # The end of the training cuts the last film.
  assert lengths == [3] * 10 + [2]
  assert len(threads) == 1
  assert not [thread for thread in threading.enumerate() if thread.name == "video"]


def test_torchs_compiler_can_be_loaded_after_a_picture(opengl: None) -> None:
  code = (
    "import mujoco; from mjlab_viewer import OffscreenRenderer\n"
    "OffscreenRenderer(mujoco.MjModel.from_xml_string('<mujoco/>')).close()\n"
    "import torch._dynamo"
  )
  subprocess.run([sys.executable, "-c", code], check=True)


def test_without_a_library_of_opengl_the_error_says_what_to_install() -> None:
  code = (
    "import os, ctypes.util; os.environ.pop('MUJOCO_GL', None); os.environ.pop('DISPLAY', None)\n"
    "ctypes.util.find_library = lambda name: None\n"
    "from mjlab_viewer.pictures.opengl import make_context\n"
    "try: make_context(8, 8)\n"
    "except ValueError as error: print(error)"
  )
  said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
  assert "neither EGL nor OSMesa is installed" in said
  assert said.count("\n") == 1


@pytest.mark.parametrize("distance", [1.0, 4.0])
def test_shadows_fall_where_the_box_hides_the_light_near_and_far_from_the_origin(opengl: None, distance: float) -> None:
  model = mujoco.MjModel.from_xml_string(GROUND)
  qpos = np.tile(model.qpos0, (2, 1, 1))
  qpos[1, 0, 0] = 30.0
  replay = Replay(model, {"qpos": qpos}, 0.02)
  camera = CameraCfg(distance=distance, elevation=-60.0)
  cfg = PictureCfg(width=320, height=240, camera=camera)
  for moment in range(2):
    replay.show(moment)
    snapshot = SnapshotTaker(replay).take((0,))
    with OffscreenRenderer(model, cfg) as renderer, OffscreenRenderer(model, replace(cfg, shadows=False)) as plain:
      lit = plain.render(snapshot).astype(int)
      dark = renderer.render(snapshot).max(axis=2) < 0.93 * lit.max(axis=2)
    seen = dark[~red(lit)]
    expected = _hidden_ground(camera.resolve(model).offset, np.array((0.2, 0.1, -1.0)), dark.shape)[~red(lit)]
    assert expected.sum() > 100
    assert (seen != expected).sum() < 0.06 * expected.sum()


def _hidden_ground(offset: np.ndarray, light: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
  """Return the pixels of ground in the shadow of the box of `GROUND`, bool (height, width)."""
  height, width = shape
  center, half = np.array((0.0, 0.0, 0.5)), np.array((0.2, 0.1, 0.1))
  forward = -offset / np.linalg.norm(offset)
  right = np.cross(forward, (0.0, 0.0, 1.0))
  right /= np.linalg.norm(right)
  v, u = np.mgrid[:height, :width] + 0.5
  slope = 2.0 * np.tan(np.deg2rad(45.0 / 2)) / height
  rays = forward + ((u - width / 2) * slope)[..., None] * right
  rays += ((height / 2 - v) * slope)[..., None] * np.cross(right, forward)
  eye = center + offset
  ground = eye - rays * (eye[2] / rays[..., 2:])
  faces = (center - ground)[..., None] + np.stack((-half, half), axis=-1)
  times = faces / -light[:, None]
  return times.min(axis=-1).max(axis=-1) < times.max(axis=-1).min(axis=-1)


def test_films_have_the_ground_and_sky_of_the_page_without_speckles_where_shadows_end(opengl: None) -> None:
  model = mujoco.MjModel.from_xml_string(GROUND)
  snapshot = SnapshotTaker(Replay(model, {"qpos": model.qpos0[None, None]}, 0.02)).take((0,))
  seen: dict[str, np.ndarray] = {}
  looks: tuple[Literal["model", "page"], ...] = ("model", "page")
  for look in looks:
    cfg = PictureCfg(width=320, height=240, camera=CameraCfg(distance=4.0), look=look)
    with OffscreenRenderer(model, cfg) as renderer:
      seen[look] = renderer.render(snapshot).astype(int)
  # Dark ground outside of any shadow.
  speckles = {look: (image[150:170, 100:140].max(axis=2) < 40).sum() for look, image in seen.items()}
  assert speckles == {"model": 0, "page": 0}
  ground = seen["page"][130:]
  is_grey = np.ptp(ground, axis=2) < 12
  assert (ground[is_grey] > 225).mean() > 0.8
  assert (seen["page"][:20] > 250).all()
  # Lines, and one shadow.
  assert 30 < (ground.max(axis=2) < 200)[is_grey].sum() < 5000
  # The model of the simulation has not changed.
  assert model.tex_data.min() < 60
