"""Velocities, resampling and editing of motions, against closed forms and kinematics."""

import math

import mujoco
import numpy as np
import pytest
import torch
from mjlab_core.errors import MjlabError
from mjlab_core.rotations import quat_apply, quat_error_magnitude, quat_from_rotvec
from mjlab_motions.editing import concatenate, crop, mirror, smooth, to_ground, twin_name
from mjlab_motions.kinematics import Kinematics
from mjlab_motions.motion import Motion
from mjlab_motions.timeline import angular_velocity, derivative, resample
from motions_robot import XML, constant, robot, wiggle


def poses(motion: Motion, kinematics: Kinematics | None = None) -> tuple[torch.Tensor, torch.Tensor]:
  kinematics = kinematics or robot()
  return kinematics.poses(motion.root_pos, motion.root_quat, kinematics.columns_of(motion))


def turning(rate: float, frames: int, axis: tuple[float, float, float], speed: float) -> Motion:
  """Turns about a fixed world axis at constant speed while all else moves on straight lines."""
  t = torch.arange(frames, dtype=torch.float64)[:, None] / rate
  axes = torch.tensor([axis], dtype=torch.float64)
  return constant().changed(
    "",
    rate=rate,
    root_pos=t * torch.tensor([[1.0, -2.0, 0.5]]),
    root_quat=quat_from_rotvec(speed * t * axes / axes.norm()),
    joint_pos=t * torch.arange(5, dtype=torch.float64),
  )


def test_velocities_of_a_uniform_motion_are_exact_everywhere() -> None:
  motion = turning(30.0, 20, (1.0, 2.0, -1.0), 3.0)
  spin = 3.0 * torch.tensor([1.0, 2.0, -1.0], dtype=torch.float64) / math.sqrt(6.0)
  torch.testing.assert_close(angular_velocity(motion.root_quat, 30.0), spin.expand(20, 3), atol=1e-9, rtol=0)
  straight = torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64).expand(20, 3)
  torch.testing.assert_close(derivative(motion.root_pos, 30.0), straight, atol=1e-9, rtol=0)


@pytest.mark.parametrize(("source", "target"), [(30.0, 50.0), (60.0, 50.0), (50.0, 25.0), (30.0, 1000.0)])
def test_resampling_a_uniform_motion_is_exact_and_keeps_the_last_moment_it_reaches(
  source: float, target: float
) -> None:
  motion = turning(source, 31, (0.3, -1.0, 0.5), 4.0)
  again = resample(motion, target)
  expected = turning(target, again.num_frames, (0.3, -1.0, 0.5), 4.0)
  assert 0.0 <= motion.duration - again.duration < 1.0 / target
  torch.testing.assert_close(again.joint_pos, expected.joint_pos, atol=1e-9, rtol=0)
  assert quat_error_magnitude(again.root_quat, expected.root_quat).max() < 1e-7


def test_resampling_to_the_same_rate_changes_nothing() -> None:
  motion = wiggle()
  assert resample(motion, motion.rate) is motion


def test_resampling_turns_the_short_way_where_signs_of_quaternions_flip() -> None:
  motion = turning(30.0, 31, (0.0, 0.0, 1.0), 2.0)
  signs = torch.where(torch.arange(31) % 2 == 0, 1.0, -1.0)[:, None]
  flipped = resample(motion.changed("", root_quat=motion.root_quat * signs), 50.0)
  assert torch.equal(flipped.root_quat, resample(motion, 50.0).root_quat)


def test_cropping_keeps_the_frames_between_two_times() -> None:
  motion = wiggle(frames=60, rate=50.0)
  part = crop(motion, 0.2, 0.6)
  assert torch.equal(part.joint_pos, motion.joint_pos[10:31])
  assert part.duration == pytest.approx(0.4)
  assert torch.equal(crop(motion).joint_pos, motion.joint_pos)
  for bad in ((0.5, 0.2), (-0.1, 0.5), (0.0, 2.0)):
    with pytest.raises(MjlabError, match=r"lasts 1\.180 s"):
      crop(motion, *bad)


def test_a_mirrored_motion_has_mirrored_kinematics() -> None:
  motion, kinematics = wiggle(), robot()
  pos, quat = poses(motion)
  pos_m, quat_m = poses(mirror(motion, kinematics))
  twins = [kinematics.body_names.index(twin_name(name)) for name in kinematics.body_names]
  assert twins != list(range(6))
  flip = torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64)
  torch.testing.assert_close(pos_m, pos[:, twins] * flip, atol=1e-12, rtol=0)
  # A mirrored orientation takes a mirrored arrow where the original takes the arrow, mirrored.
  arrow = torch.tensor([0.3, -0.5, 0.8], dtype=torch.float64)
  seen = quat_apply(quat[:, twins], arrow.expand(pos.shape)) * flip
  torch.testing.assert_close(quat_apply(quat_m, (arrow * flip).expand(pos.shape)), seen, atol=1e-12, rtol=0)


def test_mirroring_twice_gives_the_motion_back() -> None:
  motion, kinematics = wiggle(), robot()
  twice = mirror(mirror(motion, kinematics), kinematics)
  assert torch.equal(twice.joint_pos, motion.joint_pos)
  assert torch.equal(twice.root_pos, motion.root_pos)


def test_a_robot_that_is_not_symmetric_cannot_be_mirrored() -> None:
  crooked = XML.replace('name="right_knee" axis="0 1 0"', 'name="right_knee" axis="0 1 0.5"')
  with pytest.raises(MjlabError, match="'left_knee' and 'right_knee' are not mirror images"):
    mirror(wiggle(), Kinematics(mujoco.MjModel.from_xml_string(crooked)))
  nameless = XML.replace("right_knee", "other_knee")
  kinematics = Kinematics(mujoco.MjModel.from_xml_string(nameless))
  motion = wiggle().changed("", joint_names=kinematics.joint_names)
  with pytest.raises(MjlabError, match="twin of 'left_knee'"):
    mirror(motion, kinematics)


def test_joined_clips_go_on_where_and_as_the_first_ended() -> None:
  motion = wiggle()
  whole = concatenate([motion, motion], blend=0.2)
  assert whole.num_frames == 2 * motion.num_frames - 10
  # Untouched outside of the blend, the second up to a turn and a shift on the ground.
  assert torch.equal(whole.joint_pos[:50], motion.joint_pos[:50])
  assert torch.equal(whole.joint_pos[60:], motion.joint_pos[10:])
  torch.testing.assert_close(whole.root_pos[60:, 2], motion.root_pos[10:, 2])
  step = torch.linalg.vector_norm(whole.root_pos.diff(dim=0), dim=-1)
  assert step.max() < 3.0 * torch.linalg.vector_norm(motion.root_pos.diff(dim=0), dim=-1).max()
  turn = quat_error_magnitude(whole.root_quat[1:], whole.root_quat[:-1])
  assert turn.max() < 3.0 * quat_error_magnitude(motion.root_quat[1:], motion.root_quat[:-1]).max()


def test_joined_clips_may_differ_in_the_order_of_joints() -> None:
  motion = wiggle()
  other = motion.changed("", joint_pos=motion.joint_pos.flip(1), joint_names=motion.joint_names[::-1])
  joined = concatenate([motion, other])
  assert joined.joint_names == motion.joint_names
  torch.testing.assert_close(joined.joint_pos, concatenate([motion, motion]).joint_pos)


def test_clips_that_do_not_fit_are_not_joined() -> None:
  with pytest.raises(MjlabError, match="differ in rate"):
    concatenate([wiggle(), wiggle(rate=30.0)])
  with pytest.raises(MjlabError, match="blend of 9 s"):
    concatenate([wiggle(), wiggle()], blend=9.0)


def test_smoothing_weakens_a_sine_as_a_gaussian_does_and_keeps_constants() -> None:
  width, omega, rate = 0.05, 12.0, 200.0
  t = torch.arange(401, dtype=torch.float64) / rate
  motion = constant(2.0, rate=rate).changed("", joint_pos=torch.sin(omega * t)[:, None].repeat(1, 5))
  again = smooth(motion, width)
  middle = slice(100, 300)
  expected = math.exp(-0.5 * (width * omega) ** 2) * torch.sin(omega * t)
  # A kernel cut off at four deviations, and sampled.
  torch.testing.assert_close(again.joint_pos[middle, 0], expected[middle], atol=1e-4, rtol=0)
  torch.testing.assert_close(again.root_pos, motion.root_pos, atol=1e-12, rtol=0)
  torch.testing.assert_close(again.root_quat, motion.root_quat, atol=1e-12, rtol=0)


def test_on_the_ground_nineteen_of_twenty_frames_do_not_dig() -> None:
  motion = wiggle(frames=200)
  low = to_ground(motion, robot())
  heights = robot().lowest_points(*poses(low))[0][..., 2].amin(1)
  assert np.mean(heights.numpy() < -1e-9) == pytest.approx(0.05, abs=0.01)
  shift = low.root_pos - motion.root_pos
  assert (shift[:, :2] == 0.0).all()
  torch.testing.assert_close(shift[:, 2], shift[:1, 2].expand(200))
