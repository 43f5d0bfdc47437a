"""Clips of other projects, in the folder that MJLAB_MOTIONS names; they are not part of the repository.

It holds `g1-moves/*.csv` (60 Hz) with `B_HandsUp.mjlab.npz`, `kimodo/*.csv` (30 Hz), and rollouts of MuJoCo (`*.npz`).
"""

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from mjlab_motions.kinematics import Kinematics, derived_arrays
from mjlab_motions.motion import Motion
from mjlab_motions.reading.formats import read_motion
from mjlab_motions.reading.statement import Statement
from mjlab_motions.timeline import resample
from mjlab_robots import g1_spec

pytestmark = pytest.mark.skipif(
  "MJLAB_MOTIONS" not in os.environ, reason="set MJLAB_MOTIONS to a folder with g1-moves and kimodo to test real clips"
)
FOLDER = Path(os.environ.get("MJLAB_MOTIONS", "."))
CLIPS = [(path, 60.0, "xyzw") for path in sorted(FOLDER.glob("g1-moves/*.csv"))]
CLIPS += [(path, 30.0, "wxyz") for path in sorted(FOLDER.glob("kimodo/*.csv"))]
ROLLOUTS = sorted(FOLDER.glob("*.npz"))


@pytest.fixture(scope="module")
def robot() -> Kinematics:
  return Kinematics(g1_spec(meshes="never").compile())


def test_the_folder_has_clips() -> None:
  assert len(CLIPS) >= 8
  assert ROLLOUTS


@pytest.mark.parametrize(("path", "rate", "order"), CLIPS, ids=lambda value: getattr(value, "stem", None))
def test_a_clip_is_read_in_the_right_order_and_its_bodies_are_where_mujoco_has_them(
  path: Path, rate: float, order: str, robot: Kinematics
) -> None:
  motion = read_motion(path, robot, Statement(rate=rate))
  assert f"quaternions {order} (proven" in motion.history[-1]
  assert motion.rate == rate
  assert motion.joint_names == robot.joint_names
  assert_bodies_are_where_mujoco_has_them(resample(motion, 50.0), robot)


@pytest.mark.parametrize("path", ROLLOUTS, ids=lambda path: path.stem)
def test_a_rollout_of_mujoco_is_read_with_nothing_stated(path: Path, robot: Kinematics) -> None:
  motion, arrays = read_motion(path, robot), dict(np.load(path))
  assert motion.rate == pytest.approx((arrays["times"].size - 1) / np.ptp(arrays["times"]))
  assert motion.joint_names == robot.joint_names
  read = torch.cat((motion.root_pos, motion.root_quat, motion.joint_pos), 1)
  np.testing.assert_allclose(read, arrays["qpos"], atol=1e-6)
  assert_bodies_are_where_mujoco_has_them(motion, robot)


def assert_bodies_are_where_mujoco_has_them(motion: Motion, robot: Kinematics) -> None:
  derived = derived_arrays(motion, robot)
  data = mujoco.MjData(robot.model)
  for frame in range(motion.num_frames):
    data.qpos[:] = torch.cat((motion.root_pos[frame], motion.root_quat[frame], motion.joint_pos[frame]))
    mujoco.mj_kinematics(robot.model, data)
    np.testing.assert_allclose(derived["body_pos_w"][frame], data.xpos[1:], atol=1e-5)


def test_a_seven_key_file_and_our_reading_of_its_csv_are_the_same(robot: Kinematics) -> None:
  path = FOLDER / "g1-moves" / "B_HandsUp.mjlab.npz"
  theirs, read = dict(np.load(path)), read_motion(path, robot)
  assert read.rate == 60.0
  csv = read_motion(path.with_name("B_HandsUp.csv"), robot, Statement(rate=60.0))
  ours = {"joint_pos": csv.joint_pos.numpy(), **derived_arrays(csv, robot)}
  frames = len(theirs["joint_pos"])
  # Their converter drops the last frame, and repeats angular velocities at the ends where we take one-sided ones.
  assert frames == csv.num_frames - 1
  inner = slice(1, frames - 1)
  # Its sample times have single precision, so that it interpolates between frames even where it need not.
  for key, bound in (("joint_pos", 1e-5), ("body_pos_w", 1e-5), ("body_quat_w", 1e-5)):
    np.testing.assert_allclose(ours[key][:frames], theirs[key], atol=bound, err_msg=key)
  for key in ("joint_vel", "body_lin_vel_w", "body_ang_vel_w"):
    np.testing.assert_allclose(ours[key][inner], theirs[key][inner], atol=2e-3, err_msg=key)


def test_velocities_at_the_ends_agree_with_displacements_where_the_published_ones_do_not(robot: Kinematics) -> None:
  path = FOLDER / "g1-moves" / "B_HandsUp.mjlab.npz"
  csv = read_motion(path.with_name("B_HandsUp.csv"), robot, Statement(rate=60.0))
  ours, theirs = derived_arrays(csv, robot), dict(np.load(path))
  moved = (ours["body_pos_w"][1] - ours["body_pos_w"][0]) * 60.0
  ankle = robot.body_names.index("left_ankle_roll_link")
  assert np.abs(ours["body_lin_vel_w"][0] - moved).max() < 2e-4
  assert np.abs(theirs["body_lin_vel_w"][0, ankle] - moved[ankle]).max() == pytest.approx(0.056, abs=1e-3)


@pytest.mark.parametrize(("angle", "distance", "speed"), [(0.0455, 0.8e-3, 0.024), (0.097, 1.7e-3, 0.051)])
def test_one_other_reading_of_an_ankle_pitch_moves_the_ankle_alone(
  robot: Kinematics, angle: float, distance: float, speed: float
) -> None:
  csv = read_motion(FOLDER / "g1-moves" / "B_HandsUp.csv", robot, Statement(rate=60.0))
  joints = csv.joint_pos.clone()
  joints[200, robot.joint_names.index("left_ankle_pitch_joint")] += angle
  one, other = (derived_arrays(motion, robot) for motion in (csv, csv.changed("", joint_pos=joints)))
  moved = np.linalg.norm(one["body_pos_w"] - other["body_pos_w"], axis=-1).max(0)
  assert [name for name, by in zip(robot.body_names, moved, strict=True) if by > 1e-6] == ["left_ankle_roll_link"]
  assert moved.max() == pytest.approx(distance, rel=0.02)
  faster = np.linalg.norm(one["body_lin_vel_w"] - other["body_lin_vel_w"], axis=-1)
  assert faster.max() == pytest.approx(speed, rel=0.02)
  assert set(np.nonzero(faster > 1e-4)[0]) <= {199, 200, 201}
