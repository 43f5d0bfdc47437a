"""`convert-motion` where the viewer is installed too: films of clips, and clips in a browser."""

from pathlib import Path

import av
import mujoco
import numpy as np
import pytest
from mjlab.cli import convert_motion as main
from mjlab.cli._convert_motion import robot_spec
from mjlab.cli.shared._clip_preview import clip_replay, preview_model
from mjlab_motions import Kinematics, derived_arrays, load_motion, shipped_clips
from mjlab_viewer import BrowserViewer, SnapshotTaker
from mjlab_viewer.replay import Replay

CLIP = "squat_and_wave"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
  monkeypatch.chdir(tmp_path)
  return tmp_path


def test_a_clip_is_shown_with_every_link_where_the_motion_file_has_it() -> None:
  motion, robot = load_motion(shipped_clips()[CLIP]), robot_spec("g1")
  replay = clip_replay(preview_model(robot), motion)
  stored = derived_arrays(motion, Kinematics(robot.compile()))["body_pos_w"]
  assert replay.num_steps == motion.num_frames
  for _ in range(motion.num_frames // 2):
    replay.step(None)
  # Behind the world are the bodies of ground and robot, in the robot's order.
  shown = SnapshotTaker(replay).take((0,)).data["xpos"][0][-stored.shape[1] :]
  np.testing.assert_allclose(shown, stored[motion.num_frames // 2], atol=1e-5)


@pytest.mark.parametrize("ground", ['<geom type="plane" size="5 5 .1"/>', ""], ids=["own ground", "no ground"])
def test_the_scene_of_an_mjcf_has_one_ground_and_its_meshes(folder: Path, ground: str) -> None:
  (folder / "robot" / "meshes").mkdir(parents=True)
  corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
  (folder / "robot" / "meshes" / "hull.obj").write_text(corners)
  (folder / "robot" / "robot.xml").write_text(f"""
    <mujoco>
      <compiler meshdir="meshes"/>
      <asset><mesh name="hull" file="hull.obj"/></asset>
      <worldbody>{ground}<body name="boat"><freejoint/><geom type="mesh" mesh="hull"/></body></worldbody>
    </mujoco>""")
  model = preview_model(robot_spec("robot/robot.xml"))
  kinds = [mujoco.mjtGeom(kind) for kind in model.geom_type]
  assert sorted(kind.name for kind in kinds) == ["mjGEOM_MESH", "mjGEOM_PLANE"]


@pytest.mark.usefixtures("opengl", "folder")
def test_a_film_has_at_most_30_frames_per_second(capsys: pytest.CaptureFixture[str]) -> None:
  assert main([CLIP, "--crop", "1", "1.1", "--video", "squat.mp4"]) == 0
  assert "filmed squat.mp4" in capsys.readouterr().out
  with av.open("squat.mp4") as container:
    # Six frames at 50 Hz; a film has 30 a second at most.
    assert sum(1 for _ in container.decode(video=0)) == 3
    assert container.streams.video[0].average_rate == 25


def test_without_opengl_a_film_is_refused_and_nothing_is_written(
  folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  monkeypatch.setenv("MUJOCO_GL", "off")
  assert main([CLIP, "--crop", "1", "1.1", "--output", "squat.npz", "--video", "squat.mp4"]) == 1
  assert capsys.readouterr().err == "error: no pictures: MUJOCO_GL=off switches OpenGL off\n"
  assert list(folder.iterdir()) == []


def test_a_preview_is_served_after_the_clip_is_written(
  folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  def interrupted(self: BrowserViewer) -> None:
    assert (folder / "squat.npz").exists()
    assert self.playback is not None
    assert isinstance(self.playback.env, Replay)
    assert "clip squat" in self.playback.env.note(0)
    raise KeyboardInterrupt

  monkeypatch.setattr(BrowserViewer, "run", interrupted)
  assert main([CLIP, "--crop", "1", "1.1", "--output", "squat.npz", "--preview", "--port", "8370"]) == 0
  assert "open http://localhost:83" in capsys.readouterr().out
