"""`convert-motion` as a user meets it."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from mjlab_tracking.convert import main
from mjlab_tracking.editing import mirror, to_ground
from mjlab_tracking.motion import Motion, load_motion
from mjlab_tracking.timeline import resample
from tracking_robot import XML, constant, robot, wiggle


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
  monkeypatch.chdir(tmp_path)
  (tmp_path / "robot.xml").write_text(XML)
  return tmp_path


def csv(motion: Motion, path: str) -> str:
  np.savetxt(path, torch.cat((motion.root_pos, motion.root_quat, motion.joint_pos), 1).numpy(), delimiter=",")
  return path


def convert(*words: str) -> int:
  return main([*words, "--robot", "robot.xml"])


@pytest.mark.usefixtures("folder")
def test_a_csv_becomes_a_motion_file_with_a_report(capsys: pytest.CaptureFixture[str]) -> None:
  path = csv(constant(), "still.csv")
  words = [
    path,
    "--rate",
    "50",
    "--quaternion",
    "wxyz",
    "--ground",
    "--output",
    "new/still.npz",
    "--report",
    "pictures/still.png",
  ]
  assert convert(*words, "--license", "CC0-1.0", "--source", "a test") == 0
  said = capsys.readouterr().out
  assert "still: 51 frames at 50 Hz, 1.00 s: ok" in said
  assert "wrote new/still.npz" in said
  motion = load_motion("new/still.npz")
  assert (motion.license, motion.source) == ("CC0-1.0", "a test")
  assert motion.root_pos[0, 2].item() == pytest.approx(to_ground(constant(), robot()).root_pos[0, 2].item(), abs=1e-6)
  assert Path("pictures/still.png").stat().st_size > 1000


@pytest.mark.usefixtures("folder")
def test_edits_are_those_of_the_library() -> None:
  path = csv(wiggle(), "wiggle.csv")
  words = ["--rate", "50", "--mirror", "--output-rate", "30", "--accept-errors", "--output", "out.npz"]
  assert convert(path, *words) == 0
  expected = mirror(resample(wiggle(), 30.0), robot())
  torch.testing.assert_close(load_motion("out.npz").joint_pos, expected.joint_pos, atol=1e-6, rtol=0)


@pytest.mark.usefixtures("folder")
def test_a_clip_with_errors_is_not_written_unless_told_to(capsys: pytest.CaptureFixture[str]) -> None:
  path = csv(constant(height=3.0), "flying.csv")
  words = [path, "--rate", "50", "--quaternion", "wxyz", "--output", "flying.npz"]
  assert convert(*words) == 1
  assert "--accept-errors" in capsys.readouterr().err
  assert not Path("flying.npz").exists()
  assert convert(*words[:-1], "library") == 1
  assert not Path("library").exists()
  assert convert(*words, "--accept-errors") == 0
  assert Path("flying.npz").exists()


@pytest.mark.usefixtures("folder")
def test_several_clips_go_into_a_folder_or_become_one() -> None:
  paths = [csv(wiggle(), "a.csv"), csv(wiggle(), "b.csv")]
  assert convert(*paths, "--rate", "50", "--accept-errors", "--output", "library") == 0
  assert sorted(path.name for path in Path("library").iterdir()) == ["a.npz", "b.npz"]
  assert convert(*paths, "--rate", "50", "--concatenate", "0.2", "--accept-errors", "--output", "both.npz") == 0
  assert load_motion("both.npz").num_frames == 110


@pytest.mark.usefixtures("folder")
def test_a_joint_map_places_a_clip_of_another_robot() -> None:
  path = csv(wiggle(), "other.csv")
  Path("map.json").write_text(json.dumps({name: f"J{i}" for i, name in enumerate(wiggle().joint_names)}))
  words = ["--rate", "50", "--joint-names", "J0,J1,J2,J3,J4", "--joint-map", "map.json", "--accept-errors"]
  assert convert(path, *words, "--output", "mapped.npz") == 0
  assert load_motion("mapped.npz").joint_names == robot().joint_names


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
  ("words", "message"),
  [
    (["gone.csv"], "gone.csv: no such file"),
    (["wiggle.csv"], "state it with --rate"),
    (["wiggle.csv", "--rate", "50", "--output", "there.npz"], "there.npz is there already; --force"),
    (["wiggle.csv", "--rate", "50", "--video", "there.mp4"], "there.mp4 is there already; --force"),
    (["wiggle.csv", "--rate", "50", "--output", "wiggle.csv"], "expected a file that ends in .npz, or a folder"),
    (["wiggle.csv", "--rate", "50", "--report", "report.txt"], "expected a file that ends in .png, or a folder"),
    (["wiggle.csv", "--rate", "50", "--video", "film.gif"], "expected a file that ends in .mp4, or a folder"),
    (["wiggle.csv", "wiggle.csv", "--rate", "50", "--preview"], "--preview shows one clip, not 2"),
    (["wiggle.csv", "wiggle.csv", "--rate", "50", "--output", "one.npz"], "2 clips need a folder"),
    (["wiggle.csv", "wiggle.csv", "--rate", "50", "--output", "two"], "two clips would both be written"),
    (["wiggle.csv", "--rate", "50", "--crop", "0.5", "9"], "lasts 1.180 s"),
    (["wiggle.csv", "--rate", "50", "--crop", "nan", "1"], "lasts 1.180 s"),
    (["wiggle.csv", "--rate", "50", "--output-rate", "0"], "resample: the rate must be positive, got 0 Hz"),
    (["wiggle.csv", "--rate", "50", "--output-rate", "nan"], "resample: the rate must be positive, got nan Hz"),
    (["wiggle.csv", "--rate", "50", "--smooth", "inf"], "smooth: width must be positive, got inf s"),
    (["wiggle.csv", "--rate", "50", "--smooth", "nan"], "smooth: width must be positive, got nan s"),
    (["wiggle.csv", "--rate", "50", "--concatenate", "nan"], "concatenate: the blend must take time, got nan s"),
    (["wiggle.csv", "--rate", "50", "--joint-map", "robot.xml"], "not JSON"),
    (["march_in_plaze"], "clip 'march_in_plaze' does not exist. Nearest: march_in_place"),
    (["."], ". is a folder; name the clips in it: ./*"),
    (["wiggle.pkl"], "wiggle.pkl: this reads .csv and .npz"),
  ],
)
def test_a_mistake_is_one_line(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
  csv(wiggle(), "wiggle.csv")
  for name in ("wiggle.pkl", "there.npz", "there.mp4"):
    Path(name).write_bytes(b"")
  assert convert(*words) == 2
  error = capsys.readouterr().err
  assert message in error
  assert error.count("\n") == 1


def test_a_robot_that_is_not_there_is_named(capsys: pytest.CaptureFixture[str]) -> None:
  assert main(["a.csv", "--robot", "g2"]) == 2
  assert "robot 'g2': neither one of g1, go1 nor the path of an .xml" in capsys.readouterr().err


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("words", [["--video", "film.mp4"], ["--preview"]])
def test_without_the_viewer_nothing_is_written_and_it_is_named(
  words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  monkeypatch.setitem(sys.modules, "mjlab_viewer", None)
  path = csv(constant(), "still.csv")
  assert convert(path, "--rate", "50", "--quaternion", "wxyz", "--ground", "--output", "still.npz", *words) == 2
  assert "uv pip install mjlab-viewer" in capsys.readouterr().err
  assert not Path("still.npz").exists()
