"""`convert-motion`: edits, targets, mistakes, and files from other people."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from mjlab.cli import convert_motion
from mjlab_motions import Kinematics, Motion, crop, load_motion, mirror, resample, save_motion, shipped_clips, to_ground
from mjlab_motions.quality import LIMITS
from mjlab_robots import g1_spec

# Class: a name that is read from a file becomes part of a path.
ESCAPING = (
  "../../outside",
  "ABSOLUTE",
  "..",
  "...",
  "a/b",
  r"..\..\outside",
  "\x1b]0;title\x07name",
  "a\nb\x00c",
  "-rf",
  ".hidden",
  "x" * 400,
  "\u202egpj",
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
  """The current folder, two levels inside of a folder that nothing else writes to."""
  inside = tmp_path / "home" / "user"
  inside.mkdir(parents=True)
  monkeypatch.chdir(inside)
  return inside


def robot() -> Kinematics:
  return Kinematics(g1_spec(meshes="never").compile())


def march(frames: int = 60) -> Motion:
  """Part of a clip that ships."""
  return crop(load_motion(shipped_clips()["march_in_place"]), 2.0, 2.0 + (frames - 1) / 50.0)


def spiked() -> Motion:
  """Return a clip whose knee turns too fast for a simulation."""
  motion = march()
  joints = motion.joint_pos.clone()
  joints[30, motion.joint_names.index("left_knee_joint")] += 4.0
  return motion.changed("", joint_pos=joints)


def csv(motion: Motion, path: str) -> str:
  np.savetxt(path, torch.cat((motion.root_pos, motion.root_quat, motion.joint_pos), 1).numpy(), delimiter=",")
  return path


def convert(*words: str) -> int:
  return convert_motion([*words])


def test_a_csv_becomes_a_motion_file_with_a_report(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
  path = csv(march(), "march.csv")
  words = [path, "--rate", "50", "--quaternion", "wxyz", "--ground", "--output", "new/march.npz"]
  assert convert(*words, "--report", "pictures/march.png", "--license", "CC0-1.0", "--source", "a test") == 0
  said = capsys.readouterr().out
  assert "march: 60 frames at 50 Hz, 1.18 s: ok, score 0." in said
  assert "wrote new/march.npz" in said
  motion = load_motion("new/march.npz")
  assert (motion.license, motion.source) == ("CC0-1.0", "a test")
  torch.testing.assert_close(motion.root_pos, to_ground(march(), robot()).root_pos, atol=1e-6, rtol=0)
  assert (folder / "pictures" / "march.png").stat().st_size > 1000


@pytest.mark.usefixtures("folder")
def test_edits_are_those_of_the_library() -> None:
  path = csv(march(), "march.csv")
  assert convert(path, "--rate", "50", "--mirror", "--output-rate", "30", "--output", "out.npz") == 0
  expected = mirror(resample(march(), 30.0), robot())
  torch.testing.assert_close(load_motion("out.npz").joint_pos, expected.joint_pos, atol=1e-6, rtol=0)


@pytest.mark.usefixtures("folder")
def test_a_clip_with_errors_is_written_only_on_request(capsys: pytest.CaptureFixture[str]) -> None:
  words = [csv(spiked(), "spiked.csv"), "--rate", "50", "--output", "spiked.npz"]
  assert convert(*words) == 1
  assert "--accept-errors" in capsys.readouterr().err
  assert not Path("spiked.npz").exists()
  assert convert(*words[:-1], "library") == 1
  assert not Path("library").exists()
  assert convert(*words, "--accept-errors") == 0
  assert Path("spiked.npz").exists()


# Class: a finding that training can live with refuses the clip. B_Fence1 of the public G1 Moves has this foot skate.
@pytest.mark.usefixtures("folder")
def test_a_clip_that_only_warns_is_written(capsys: pytest.CaptureFixture[str]) -> None:
  slide = torch.arange(60, dtype=torch.float64)[:, None] / 50.0 * torch.tensor([0.575, 0.0, 0.0])
  motion = load_motion(shipped_clips()["squat_and_wave"])
  still = motion.changed(
    "",
    root_pos=motion.root_pos[:1] + slide,
    root_quat=motion.root_quat[:1].repeat(60, 1),
    joint_pos=motion.joint_pos[:1].repeat(60, 1),
  )
  assert convert(csv(still, "skate.csv"), "--rate", "50", "--quaternion", "wxyz", "--output", "skate.npz") == 0
  said = capsys.readouterr().out
  assert "1.18 s: warning, score 1.15" in said
  (row,) = [line.split() for line in said.splitlines() if line.startswith("foot_skate")]
  assert row[1] == "0.575"
  assert load_motion("skate.npz").num_frames == 60


@pytest.mark.usefixtures("folder")
def test_several_clips_go_into_a_folder_or_become_one() -> None:
  paths = [csv(march(), "a.csv"), csv(march(), "b.csv")]
  assert convert(*paths, "--rate", "50", "--output", "library") == 0
  assert sorted(path.name for path in Path("library").iterdir()) == ["a.npz", "b.npz"]
  assert convert(*paths, "--rate", "50", "--concatenate", "0.2", "--output", "both.npz") == 0
  assert load_motion("both.npz").num_frames == 110


@pytest.mark.usefixtures("folder")
def test_a_joint_map_places_a_clip_of_another_robot() -> None:
  path = csv(march(), "other.csv")
  names = march().joint_names
  Path("map.json").write_text(json.dumps({name: f"J{i}" for i, name in enumerate(names)}))
  Path("names.txt").write_text("\n".join(f"J{i}" for i in range(len(names))))
  words = ["--rate", "50", "--joint-names", "names.txt", "--joint-map", "map.json"]
  assert convert(path, *words, "--output", "mapped.npz") == 0
  assert load_motion("mapped.npz").joint_names == robot().joint_names


def files(folder: Path) -> set[Path]:
  return {path for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", ESCAPING)
def test_a_name_from_a_file_chooses_no_folder(folder: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
  outside = str(folder.parents[1] / "outside")
  save_motion(march(9).changed("", name=name.replace("ABSOLUTE", outside)), "clip.npz")
  before = files(folder.parents[1])
  # Pictures take time.
  report = ["--report", "pictures"] if name in ("../../outside", "a\nb\x00c") else []
  assert convert("clip.npz", "--force", "--output", "out", *report) == 0
  new = files(folder.parents[1]) - before
  assert sorted(path.parent.relative_to(folder).as_posix() for path in new) == ["out", *report[1:]]
  said = capsys.readouterr().out
  assert said.replace("\n", "").isprintable()
  assert len(said.splitlines()) == len(LIMITS) + 4 + len(report[1:])


@pytest.mark.usefixtures("folder")
def test_words_from_a_file_reach_the_terminal_without_control_characters(capsys: pytest.CaptureFixture[str]) -> None:
  evil = "\x1b[2J\nerror: disk erased"
  motion = march(9).changed(evil, name=evil, source=evil, license=evil)
  for odd in ({"joint_names": (*motion.joint_names[:-1], evil)}, {"root_body": evil}):
    save_motion(motion.changed("", **odd), "clip.npz")
    assert convert("clip.npz") == 1
  arrays: dict[str, Any] = {evil: np.zeros(3)}
  np.savez("arrays.npz", **arrays)
  assert convert("arrays.npz") == 1
  Path(f"{evil[4:]}.csv").write_text("no numbers\n")
  assert convert(f"{evil[4:]}.csv", "--rate", "50") == 1
  error = capsys.readouterr().err
  assert len(error.splitlines()) == 4
  assert error.replace("\n", "").isprintable()
