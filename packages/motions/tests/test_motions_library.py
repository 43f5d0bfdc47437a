"""Clip libraries: names, frames, bins and weights."""

import json
from pathlib import Path

import pytest
import torch
from mjlab_core.errors import MjlabError
from mjlab_motions.clips import find_clips, shipped_clips
from mjlab_motions.editing import crop
from mjlab_motions.kinematics import derived_arrays
from mjlab_motions.library import MotionLibrary, load_library
from mjlab_motions.motion import Motion
from mjlab_motions.motion_file import save_motion
from mjlab_motions.timeline import resample
from motions_robot import constant, robot, wiggle

BODIES = ("left_shin", "pelvis", "arm")


def library(*motions: Motion, weights: list[float] | None = None, rate: float = 50.0) -> MotionLibrary:
  return MotionLibrary(motions, robot(), BODIES, rate=rate, weights=weights, dtype=torch.float64)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
  for name in ("a", "b", "c"):
    save_motion(wiggle(), tmp_path / f"{name}.npz")
  return tmp_path


def test_rows_are_the_frames_of_each_clip_in_turn() -> None:
  first, second = wiggle(frames=40), crop(wiggle(frames=60), 0.2)
  lib = library(first, second)
  assert lib.lengths.tolist() == [40, 50]
  assert lib.offsets.tolist() == [0, 40]
  derived = derived_arrays(second, robot())
  rows = lib.table[40:]
  torch.testing.assert_close(rows[:, lib.columns["joint_pos"]], second.joint_pos)
  ids = [robot().body_names.index(body) for body in BODIES]
  for column, key in (
    ("body_pos", "body_pos_w"),
    ("body_quat", "body_quat_w"),
    ("lin_vel", "body_lin_vel_w"),
    ("ang_vel", "body_ang_vel_w"),
  ):
    expected = torch.from_numpy(derived[key][:, ids]).double().flatten(1)
    torch.testing.assert_close(rows[:, lib.columns[column]], expected, atol=1e-5, rtol=0)


def test_a_clip_of_another_rate_plays_at_its_own_speed() -> None:
  motion = wiggle(frames=61, rate=30.0)
  lib = library(motion)
  assert lib.lengths.tolist() == [101]
  torch.testing.assert_close(lib.table[:, lib.columns["joint_pos"]], resample(motion, 50.0).joint_pos)


def test_each_frame_but_the_last_is_within_the_bounds_of_its_bin() -> None:
  lib = library(*(wiggle(frames=n) for n in (4, 51, 130, 77)))
  assert lib.bin_counts.tolist() == [1, 1, 3, 2]
  for clip in range(lib.num_clips):
    frames = torch.arange(int(lib.lengths[clip]) - 1)
    bins = lib.bin_of(torch.full_like(frames, clip), frames)
    assert lib.clip_of_bin[bins].eq(clip).all()
    assert (lib.bin_first[bins] <= frames).all()
    assert (frames < lib.bin_end[bins]).all()
    assert bins.unique().numel() == lib.bin_counts[clip]
    # The last frame counts in the bin of the frame before.
    assert lib.bin_of(torch.tensor([clip]), lib.lengths[clip : clip + 1] - 1) == bins[-1]


def test_every_moment_is_as_likely_but_for_weights() -> None:
  lib = library(wiggle(frames=101), wiggle(frames=51), weights=[1.0, 4.0])
  assert lib.clip_share.tolist() == pytest.approx([2 / 6, 4 / 6])
  assert lib.bin_share.tolist() == pytest.approx([1 / 6, 1 / 6, 4 / 6])


def test_a_folder_has_weights_and_splits(folder: Path) -> None:
  (folder / "library.json").write_text(json.dumps({"b.npz": {"weight": 3.0}, "c.npz": {"split": "test"}}))
  found = find_clips(str(folder), "train")
  assert [(entry.path.name, entry.weight) for entry in found] == [("a.npz", 1.0), ("b.npz", 3.0)]
  assert [entry.path.name for entry in find_clips(str(folder), "test")] == ["c.npz"]
  assert len(find_clips(str(folder))) == 3
  lib = load_library(str(folder), robot(), BODIES, rate=50.0, split="train")
  # Both files hold a motion called "wiggle".
  assert lib.clip_names == ("a", "b")
  assert lib.clip_share.tolist() == pytest.approx([0.25, 0.75])


@pytest.mark.parametrize(
  ("index", "message"),
  [
    ({"d.npz": {}}, "clip 'd.npz' does not exist"),
    ({"a.npz": {"wieght": 2}}, "unknown field `wieght`"),
    ({"a.npz": {"weight": 0}}, r"`float` > 0\.0 - at `\$\[\.\.\.\]\.weight`; expected"),
    ({"a.npz": {"weight": float("nan")}}, "JSON is malformed"),
    ([], "expected"),
  ],
)
def test_a_mistake_in_the_index_is_named(folder: Path, index: object, message: str) -> None:
  (folder / "library.json").write_text(json.dumps(index))
  with pytest.raises(MjlabError, match=message):
    find_clips(str(folder))


def test_an_unknown_name_is_refused(folder: Path) -> None:
  with pytest.raises(MjlabError, match=r"motion 'squat' does not exist\. Nearest: squat_and_wave"):
    find_clips("squat")
  (folder / "a.csv").write_text("0,0,1")
  with pytest.raises(MjlabError, match=r"a\.csv: a clip to follow is an \.npz; `convert-motion"):
    find_clips(str(folder / "a.csv"))
  with pytest.raises(MjlabError, match="no clip of split 'val'; there is: train"):
    find_clips(str(folder), "val")
  with pytest.raises(MjlabError, match=r"body 'right_shine' does not exist\. Nearest: right_shin"):
    MotionLibrary([constant()], robot(), ["right_shine"], rate=50.0)


def test_shipped_clips_are_found_by_name() -> None:
  for name, path in shipped_clips().items():
    assert [entry.path for entry in find_clips(name)] == [path]
