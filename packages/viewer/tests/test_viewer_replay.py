"""Replays of stored moments: steps, pauses and films."""

from pathlib import Path

import av
import mujoco
import numpy as np
import pytest
import torch
from mjlab_viewer import BrowserViewer, OffscreenRenderer, PictureCfg, Playback, Replay, SnapshotTaker, ZeroPolicy
from viewer_env import BOX

MODEL: mujoco.MjModel = mujoco.MjModel.from_xml_string(BOX)


def rising(moments: int = 7, **model_fields: np.ndarray) -> Replay:
  """Return two worlds whose boxes rise by 0.1 m at each moment, the second one metre to the side."""
  qpos = np.tile(MODEL.qpos0, (moments, 2, 1))
  qpos[:, 1, 0] += 1.0
  qpos[..., 2] += 0.1 * np.arange(moments)[:, None]
  return Replay(MODEL, {"qpos": qpos}, 0.02, model_fields)


def heights(replay: Replay) -> list[float]:
  return [round(height, 3) for height in SnapshotTaker(replay).take((0, 1)).data["xpos"][:, 1, 2].tolist()]


def test_the_first_moment_follows_the_last() -> None:
  replay = rising(3)
  seen, ends = [heights(replay)], []
  for _ in range(4):
    _, _, over, _, _ = replay.step(None)
    seen.append(heights(replay))
    ends.append(over.tolist())
  assert seen == [[0.5, 0.5], [0.6, 0.6], [0.7, 0.7], [0.5, 0.5], [0.6, 0.6]]
  assert ends == [[False, False], [False, False], [True, True], [False, False]]


def test_poses_are_those_of_mujoco_with_each_worlds_own_model() -> None:
  body_pos = np.stack([MODEL.body_pos, MODEL.body_pos])
  geom_rgba = np.stack([MODEL.geom_rgba, MODEL.geom_rgba[::-1]])
  replay = rising(2, body_pos=body_pos, geom_rgba=geom_rgba)
  replay.step(None)
  snapshot = SnapshotTaker(replay).take((1,))
  data = mujoco.MjData(MODEL)
  data.qpos[:] = snapshot.data["qpos"][0]
  mujoco.mj_kinematics(MODEL, data)
  np.testing.assert_array_equal(snapshot.data["xpos"][0], data.xpos)
  np.testing.assert_array_equal(snapshot.model["geom_rgba"][0], MODEL.geom_rgba[::-1])
  assert replay.signals()["qpos"][1].tolist()[1] == snapshot.data["qpos"][0].tolist()


def test_a_replay_goes_on_from_the_shown_moment() -> None:
  replay = rising(5)
  playback = Playback(replay, ZeroPolicy(2, 0, torch.device("cpu")))
  replay.show(3)
  assert heights(replay) == [0.8, 0.8]
  assert replay.note(1) == "moment 4 of 5, 0.06 s, world 1"
  playback.pause()
  playback.step_once()
  assert heights(replay) == [0.9, 0.9]
  replay.show(99)
  assert heights(replay) == [0.9, 0.9]
  playback.reset()
  assert heights(replay) == [0.5, 0.5]


def test_moving_the_time_line_of_a_replay_pauses_it_there_and_play_goes_on() -> None:
  replay = rising(7)
  now = [0.0]
  playback = Playback(replay, ZeroPolicy(2, 0, torch.device("cpu")), clock=lambda: now[0])
  with BrowserViewer(replay, playback=playback, port=8305) as viewer:
    controls = viewer._controls
    assert controls is not None
    slider = controls._time.slider

    def run(seconds: float) -> None:
      now[0] += seconds
      playback.tick()
      viewer.update()
      controls.show_status()

    run(0.0)
    run(0.3)
    moved = replay.at
    assert moved > 0
    assert slider.value == pytest.approx(moved * 0.02)
    slider.value = 0.04
    run(0.1)
    run(0.1)
    assert playback.paused
    assert replay.at == 2
    assert "moment 3 of 7, 0.04 s" in controls._status.content
    # The next moment is due.
    playback.resume()
    playback.tick()
    now[0] += 0.021
    playback.tick()
    assert replay.at == 3


def test_writing_to_the_shown_moment_is_not_stored() -> None:
  replay = rising(2)
  replay.sim.data.qpos[:] += 1.0
  replay.step(None)
  replay.step(None)
  assert replay.sim.data.qpos[0].tolist() == MODEL.qpos0.tolist()


def test_a_film_shows_every_moment_once(opengl: None, tmp_path: Path) -> None:
  frames = []
  with OffscreenRenderer(MODEL, PictureCfg(width=96, height=48, shadows=False)) as renderer:
    rising(7).film(tmp_path / "film.mp4", renderer, speed=0.5, every=2, on_frame=frames.append)
  assert frames == [1, 2, 3, 4]
  with av.open(str(tmp_path / "film.mp4")) as container:
    pictures = [frame.to_ndarray(format="rgb24").astype(int) for frame in container.decode(video=0)]
    assert container.streams.video[0].average_rate == 0.5 / (2 * 0.02)
  assert len(pictures) == 4
  # The camera follows the box, so that the floor sinks.
  assert np.abs(pictures[-1] - pictures[0]).mean() > 2.0


def test_a_film_that_fails_leaves_nothing(opengl: None, tmp_path: Path) -> None:
  renderer = OffscreenRenderer(MODEL, PictureCfg(width=96, height=48, shadows=False))
  renderer.close()
  with pytest.raises(AssertionError):
    rising().film(tmp_path / "film.mp4", renderer)
  assert list(tmp_path.iterdir()) == []


def test_a_single_moment_can_be_seen_in_a_browser() -> None:
  replay = rising(1)
  playback = Playback(replay, ZeroPolicy(2, 0, torch.device("cpu")))
  with BrowserViewer(replay, playback=playback, port=8300) as viewer:
    viewer.scene.show(SnapshotTaker(replay).take((0, 1)))
    assert playback.error is None
