"""Motion files and other formats: round trips, proofs of unstated orders, and refusals."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from mjlab_core.errors import FileError, MjlabError
from mjlab_motions.kinematics import derived_arrays
from mjlab_motions.motion import Motion
from mjlab_motions.motion_file import load_motion, save_motion
from mjlab_motions.reading.formats import read_motion
from mjlab_motions.reading.statement import Statement
from motions_robot import arrays_of, npz, qpos_of, robot, wiggle


def written(motion: Motion, path: Path, quaternion: str = "wxyz", header: bool = False) -> Path:
  table = qpos_of(motion, motion.root_quat.roll(-1, 1) if quaternion == "xyzw" else None)
  names = ["x", "y", "z", "q0", "q1", "q2", "q3", *motion.joint_names]
  np.savetxt(path, table, delimiter=",", header=",".join(names) if header else "", comments="")
  return path


def assert_same(one: Motion, other: Motion, atol: float = 1e-6) -> None:
  assert one.joint_names == other.joint_names
  assert one.rate == other.rate
  torch.testing.assert_close(one.root_pos, other.root_pos, atol=atol, rtol=0)
  torch.testing.assert_close(one.joint_pos, other.joint_pos, atol=atol, rtol=0)
  torch.testing.assert_close(
    (one.root_quat * other.root_quat).sum(-1).abs(), torch.ones(one.num_frames, dtype=torch.float64), atol=atol, rtol=0
  )


def refused(path: Path, message: str, **said: Any) -> None:
  with pytest.raises(MjlabError, match=message):
    read_motion(path, robot(), Statement(**said))


def seven_keys(motion: Motion) -> dict[str, Any]:
  arrays: dict[str, Any] = derived_arrays(motion, robot())
  del arrays["body_names"]
  return {"fps": np.array([motion.rate]), "joint_pos": motion.joint_pos.numpy().astype(np.float32), **arrays}


def test_a_motion_file_gives_back_what_was_written(tmp_path: Path) -> None:
  motion = wiggle().changed("made for a test", source="here", license="Apache-2.0")
  path = tmp_path / "wiggle.npz"
  arrays = arrays_of(motion, path)
  back = load_motion(path)
  assert_same(back, motion)
  assert (back.name, back.source, back.license, back.history) == ("wiggle", "here", "Apache-2.0", ("made for a test",))
  assert_same(read_motion(path, robot()), motion)
  # A file may lack its history.
  metadata = json.loads(str(arrays["metadata"]))
  del metadata["history"]
  assert read_motion(npz(path, **arrays | {"metadata": np.array(json.dumps(metadata))}), robot()).history == ()


def test_a_motion_file_describes_itself_and_holds_the_seven_keys(tmp_path: Path) -> None:
  arrays = arrays_of(wiggle(), tmp_path / "wiggle.npz")
  for word in ("rad", "(w, x, y, z)", "mjlab-motion"):
    assert word in str(arrays["metadata"])
  assert list(arrays["body_names"]) == list(robot().body_names)
  assert {key: arrays[key].shape for key in seven_keys(wiggle())} == {
    key: value.shape for key, value in seven_keys(wiggle()).items()
  }


def test_a_file_with_python_objects_is_refused_unread(tmp_path: Path) -> None:
  path = tmp_path / "pickled.npz"
  npz(path, **arrays_of(wiggle(), path) | {"joint_names": np.array([{"a": 1}], dtype=object)})
  with pytest.raises(FileError, match="joint_names holds Python objects, which are not read"):
    load_motion(path)


@pytest.mark.parametrize("contents", [b"", b"not a zip", b"PK\x03\x04 cut off"])
def test_a_damaged_file_is_named(tmp_path: Path, contents: bytes) -> None:
  path = tmp_path / "broken.npz"
  path.write_bytes(contents)
  # NumPy takes other files for pickles, and explains how to run them.
  with pytest.raises(MjlabError, match=r"broken\.npz: File is not a zip file"):
    load_motion(path)


def test_a_half_written_file_never_takes_the_place_of_a_whole_one(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  path = tmp_path / "wiggle.npz"
  save_motion(wiggle(), path)
  before = path.read_bytes()

  def fails(target: Any, **_: object) -> None:
    target.write(b"half")
    raise OSError("disk full")

  monkeypatch.setattr(np, "savez_compressed", fails)
  with pytest.raises(OSError, match="disk full"):
    save_motion(wiggle(), path)
  assert path.read_bytes() == before
  assert list(tmp_path.iterdir()) == [path]


def rooted(quat: torch.Tensor, path: Path, key: str = "joint_pos") -> Path:
  """Write an `.npz` with root and joints in one array."""
  return npz(path, **{key: qpos_of(wiggle(), quat)}, fps=np.array([50.0]))


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_the_order_of_quaternions_of_an_upright_clip_is_proven(tmp_path: Path, order: str, kind: str) -> None:
  quat = wiggle().root_quat if order == "wxyz" else wiggle().root_quat.roll(-1, 1)
  path = rooted(quat, tmp_path / "wiggle.npz") if kind == "npz" else written(wiggle(), tmp_path / "wiggle.csv", order)
  motion = read_motion(path, robot(), Statement(rate=50.0))
  assert_same(motion, wiggle())
  assert f"quaternions {order} (proven" in motion.history[-1]


@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_an_order_of_quaternions_that_cannot_be_proven_must_be_stated(tmp_path: Path, kind: str) -> None:
  # Both readings of (0, 0, 0, 1) are upright: unturned, and turned round once.
  motion = wiggle()
  ahead = torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64).repeat(motion.num_frames, 1)
  if kind == "npz":
    path = rooted(ahead.roll(-1, 1), tmp_path / "ahead.npz")
  else:
    path = written(motion.changed("ahead", root_quat=ahead), tmp_path / "ahead.csv", "xyzw")
  refused(path, r"cannot be proven .*wxyz \+1\.00, xyzw \+1\.00.*--quaternion", rate=50.0)
  assert torch.equal(read_motion(path, robot(), Statement(rate=50.0, quaternion="xyzw")).root_quat, ahead)


def test_a_missing_rate_must_be_stated_and_a_stated_one_must_be_that_of_the_file(tmp_path: Path) -> None:
  refused(written(wiggle(), tmp_path / "wiggle.csv"), "does not contain its rate; state it with --rate")
  arrays = seven_keys(wiggle())
  refused(npz(tmp_path / "seven.npz", **arrays), "the file says 50 Hz, --rate says 30", rate=30.0)
  del arrays["fps"]
  path = npz(tmp_path / "seven.npz", **arrays)
  refused(path, "does not contain its rate; state it with --rate")
  assert read_motion(path, robot(), Statement(rate=50.0)).rate == 50.0


def test_a_wrong_number_of_columns_is_refused(tmp_path: Path) -> None:
  path = tmp_path / "short.csv"
  np.savetxt(path, np.tile([0, 0, 0.7, 1, 0, 0, 0.0, 0.1], (5, 1)), delimiter=",")
  refused(path, r"8 columns, expected 7 of the root and 5 of joints", rate=50.0, quaternion="wxyz")


def test_a_header_names_the_joints_and_their_order_does_not_matter(tmp_path: Path) -> None:
  motion = wiggle()
  turned = motion.changed("turned", joint_names=motion.joint_names[::-1], joint_pos=motion.joint_pos.flip(1))
  path = written(turned, tmp_path / "named.csv", header=True)
  back = read_motion(path, robot(), Statement(rate=50.0))
  torch.testing.assert_close(robot().columns_of(back), motion.joint_pos, atol=1e-12, rtol=0)


def test_a_header_may_be_quoted_commented_out_or_come_after_other_lines(tmp_path: Path) -> None:
  motion = wiggle()
  path = written(motion.changed("", joint_pos=motion.joint_pos.flip(1), joint_names=motion.joint_names[::-1]),
    tmp_path / "wiggle.csv", header=True)  # fmt: skip
  header, _, rows = path.read_text().partition("\n")
  quoted = ",".join(f'"{name}"' for name in header.split(","))
  for head in (quoted, f"# {header}", f"\n# a comment\n\n{header}"):
    path.write_text(f"{head}\n{rows}")
    back = read_motion(path, robot(), Statement(rate=50.0))
    torch.testing.assert_close(robot().columns_of(back), motion.joint_pos, atol=1e-9, rtol=0)


@pytest.mark.parametrize(
  ("contents", "message"),
  [
    (b"", "the file has no numbers"),
    (b"\n\n", "the file has no numbers"),
    (b"x,y,z\n", "the file has no numbers"),
    (b"x\xe9,y\n1,2\n", "codec can.t decode"),
    (bytes(range(256)), "codec can.t decode"),
    (b"dance\n1,2,3\n", "3 columns, expected 7 of the root and 0 of joints"),
    (b"1;2;3\n1;2;3\n", "could not convert string"),
    (b"1,2,3\n1,2\n", "number of columns changed"),
  ],
)
def test_a_csv_without_a_table_is_refused_by_name(tmp_path: Path, contents: bytes, message: str) -> None:
  path = tmp_path / "odd.csv"
  path.write_bytes(contents)
  refused(path, rf"odd\.csv: .*({message})", rate=50.0)


def test_a_joint_map_renames_leaves_out_and_holds_joints(tmp_path: Path) -> None:
  motion = wiggle()
  names = [f"J{i}" for i in range(5)]
  joint_map: dict[str, str | float] = {name: f"J{i}" for i, name in enumerate(motion.joint_names)}
  joint_map["reach"] = 0.25
  said = Statement(rate=50.0, joint_names=names, joint_map=joint_map)
  back = read_motion(written(motion, tmp_path / "other.csv"), robot(), said)
  kept = [i for i, name in enumerate(motion.joint_names) if name != "reach"]
  torch.testing.assert_close(back.joint_pos[:, kept], motion.joint_pos[:, kept], atol=1e-12, rtol=0)
  assert (back.joint_pos[:, motion.joint_names.index("reach")] == 0.25).all()
  joint_map["left_nee"] = "J1"
  with pytest.raises(MjlabError, match=r"'left_nee' does not exist\. Nearest: left_knee"):
    read_motion(tmp_path / "other.csv", robot(), said)


def test_a_mujoco_rollout_is_read_with_the_rate_of_its_times(tmp_path: Path) -> None:
  motion = wiggle()
  path = npz(tmp_path / "rollout.npz", qpos=qpos_of(motion), times=np.arange(motion.num_frames) / 50.0)
  back = read_motion(path, robot())
  assert_same(back, motion.changed("", rate=back.rate))
  assert back.rate == pytest.approx(50.0)


def test_a_file_with_the_root_in_front_of_named_joints_is_read_by_name(tmp_path: Path) -> None:
  motion = wiggle()
  joints = qpos_of(motion.changed("", joint_pos=motion.joint_pos.flip(1)))
  arrays: dict[str, Any] = seven_keys(motion) | {"joint_pos": joints, "joint_names": np.array(motion.joint_names[::-1])}
  path = npz(tmp_path / "named.npz", **arrays)
  torch.testing.assert_close(robot().columns_of(read_motion(path, robot())), motion.joint_pos, atol=1e-9, rtol=0)


def test_a_rollout_with_quaternions_of_another_order_is_refused(tmp_path: Path) -> None:
  path = rooted(wiggle().root_quat.roll(-1, 1), tmp_path / "rollout.npz", "qpos")
  refused(path, r"a qpos has w first, but only as xyzw it is upright.*--quaternion")
  assert_same(read_motion(path, robot(), Statement(quaternion="xyzw")), wiggle())


def test_a_stated_order_is_never_ignored(tmp_path: Path) -> None:
  save_motion(wiggle(), tmp_path / "ours.npz")
  refused(tmp_path / "ours.npz", "the file has w first, --quaternion says xyzw", quaternion="xyzw")
  arrays = seven_keys(wiggle())
  np.savez(tmp_path / "seven.npz", **arrays | {"body_quat_w": np.roll(arrays["body_quat_w"], -1, -1)})
  refused(tmp_path / "seven.npz", "no order of joints and bodies agrees")
  assert_same(read_motion(tmp_path / "seven.npz", robot(), Statement(quaternion="xyzw")), wiggle())


@pytest.mark.parametrize("bodies", ["depth first", "shuffled"])
@pytest.mark.parametrize("joints", ["depth first", "breadth first"])
def test_orders_of_a_seven_key_file_are_proven_by_kinematics(tmp_path: Path, joints: str, bodies: str) -> None:
  motion, kinematics = wiggle(), robot()
  arrays = seven_keys(motion)
  # hip, hip, reach, knee, knee: by distance from the root.
  order = [0, 2, 4, 1, 3] if joints == "breadth first" else [0, 1, 2, 3, 4]
  arrays |= {key: arrays[key][:, order] for key in ("joint_pos", "joint_vel")}
  rows = [0, 1, 2, 3, 4, 5] if bodies == "depth first" else [3, 5, 0, 1, 4, 2]
  arrays |= {key: value[:, rows] for key, value in arrays.items() if key.startswith("body")}
  path = npz(tmp_path / "seven.npz", **arrays)
  back = read_motion(path, kinematics)
  assert f"joints ({joints})" in back.history[-1]
  torch.testing.assert_close(kinematics.columns_of(back), motion.joint_pos, atol=1e-6, rtol=0)
  torch.testing.assert_close(back.root_pos, motion.root_pos, atol=1e-6, rtol=0)


def test_a_seven_key_file_that_no_order_explains_is_refused(tmp_path: Path) -> None:
  arrays = seven_keys(wiggle())
  arrays["joint_pos"] = arrays["joint_pos"][:, [1, 2, 3, 4, 0]]
  path = npz(tmp_path / "seven.npz", **arrays)
  refused(path, r"no order of joints and bodies agrees .*--joint-names and --body-names")
  stated = [robot().joint_names[i] for i in (1, 2, 3, 4, 0)]
  back = read_motion(path, robot(), Statement(joint_names=stated))
  torch.testing.assert_close(robot().columns_of(back), wiggle().joint_pos, atol=1e-6, rtol=0)


def test_swapped_bodies_and_positions_that_are_not_finite_prove_no_order(tmp_path: Path) -> None:
  arrays, names = seven_keys(wiggle()), list(robot().body_names)
  path = npz(tmp_path / "seven.npz", **arrays)
  assert_same(read_motion(path, robot(), Statement(body_names=names)), wiggle())
  swapped = [names[index] for index in (0, 3, 2, 1, 4, 5)]
  refused(path, "no order of joints and bodies agrees", body_names=swapped)
  arrays["body_pos_w"][:, -1] = np.nan
  refused(npz(path, **arrays), "no order of joints and bodies agrees", body_names=names)


def test_bodies_without_relation_to_a_joint_do_not_prove_its_order(tmp_path: Path) -> None:
  arrays: dict[str, Any] = seven_keys(wiggle())
  few = [robot().body_names.index(name) for name in ("pelvis", "left_thigh", "right_thigh", "arm")]
  arrays |= {key: value[:, few] for key, value in arrays.items() if key.startswith("body")}
  arrays["body_names"] = np.array(["pelvis", "left_thigh", "right_thigh", "arm"])
  path = npz(tmp_path / "seven.npz", **arrays)
  refused(path, r"without body 'left_shin' .*--joint-names")
  assert_same(read_motion(path, robot(), Statement(joint_names=robot().joint_names)), wiggle())
  arrays["body_names"] = np.array(["pelvis", "arm", "arm", "arm"])
  refused(npz(path, **arrays), "4 names, 2 different ones, for 4 bodies")


@pytest.mark.parametrize("kind", ["ours", "seven keys", "rollout"])
def test_arrays_of_a_wrong_type_or_shape_are_refused_by_name(tmp_path: Path, kind: str) -> None:
  motion = wiggle()
  path = tmp_path / "odd.npz"
  arrays: dict[str, Any]
  if kind == "ours":
    arrays = arrays_of(motion, path)
    keys = "fps", "joint_names", "root_pos_w", "root_quat_w", "joint_pos", "body_names", "body_pos_w", "body_quat_w"
  elif kind == "seven keys":
    arrays = seven_keys(motion) | {"joint_names": np.array(motion.joint_names)}
    keys = "fps", "joint_names", "joint_pos", "body_pos_w", "body_quat_w"
  else:
    arrays = {"qpos": qpos_of(motion), "times": np.arange(60) / 50.0}
    keys = "qpos", "times"
  for key in keys:
    # No axes, words or numbers where there should be the other, nothing, one frame less, and no longer real.
    value = arrays[key]
    odd = [np.array(1.0) if key != "fps" else np.array("1"), np.full(value.shape, "a"), np.zeros(0)]
    if len(value) == 60:
      odd.append(value[:-1])
    if value.dtype.kind == "f":
      odd.append(value.astype(np.complex128))
    for other in odd:
      if key == "joint_names" and other.dtype.kind == "U":
        continue
      npz(path, **arrays | {key: other})
      with pytest.raises(MjlabError, match=r"odd|wiggle"):
        read_motion(path, robot())


@pytest.mark.parametrize(
  ("times", "message"),
  [
    (np.zeros(60), "not evenly spaced"),
    (np.arange(60) ** 1.1, "not evenly spaced"),
    (np.full(60, np.nan), "not evenly spaced"),
    (-np.arange(60.0), "not evenly spaced"),
    (np.arange(20) / 50.0, "does not contain its rate"),
  ],
)
def test_impossible_times_of_frames_are_refused(tmp_path: Path, times: np.ndarray, message: str) -> None:
  refused(npz(tmp_path / "rollout.npz", qpos=qpos_of(wiggle()), times=times), message)


def test_bodies_of_another_model_in_a_motion_file_are_refused(tmp_path: Path) -> None:
  derived = derived_arrays(wiggle(), robot())
  derived["body_pos_w"][:, 2] += 0.03
  path = tmp_path / "other.npz"
  save_motion(wiggle(), path, derived)
  refused(path, r"body 'left_shin' is 0\.0\d+ m or rad from")


@pytest.mark.parametrize(
  ("change", "message"),
  [
    ({"joint_pos": torch.full((60, 5), torch.nan, dtype=torch.float64)}, "joint_pos has numbers that are not finite"),
    ({"root_quat": 1.1 * wiggle().root_quat}, r"length 1\.100 in frame"),
    ({"rate": 0.0}, "rate must be in .1, 10000."),
    ({"root_pos": wiggle().root_pos[:59]}, "shape"),
  ],
)
def test_an_impossible_motion_is_refused(change: dict, message: str) -> None:
  with pytest.raises(MjlabError, match=message):
    wiggle().changed("broken", **change)
