"""Time derivatives of motions, and resampling."""

import math

import torch
from mjlab_core.constraints import check_value
from mjlab_core.errors import MjlabError
from mjlab_core.rotations import quat_box_minus, quat_slerp

from mjlab_motions.motion import MAX_FRAMES, Motion, Rate


def derivative(values: torch.Tensor, rate: float) -> torch.Tensor:
  """Return the rate of change of evenly spaced values, (frames, n): central differences, one-sided at both ends.

  Args:
    values: (frames, n), at least two frames.
    rate: Frames per second [Hz].
  """
  inner = (values[2:] - values[:-2]) * (0.5 * rate)
  return torch.cat(((values[1:2] - values[:1]) * rate, inner, (values[-1:] - values[-2:-1]) * rate))


def angular_velocity(quat: torch.Tensor, rate: float) -> torch.Tensor:
  """Return the angular velocity in world axes, (frames, 3) [rad/s].

  It is log(q[k+1] q[k-1]^-1) / 2 dt, one-sided at both ends.
  """
  inner = quat_box_minus(quat[2:], quat[:-2]) * (0.5 * rate)
  return torch.cat((quat_box_minus(quat[1:2], quat[:1]) * rate, inner, quat_box_minus(quat[-1:], quat[-2:-1]) * rate))


def resample(motion: Motion, rate: float) -> Motion:
  """Return the motion at another rate, from its first frame to the last moment that its frames reach.

  Positions are interpolated linearly and rotations along the shortest way at constant speed; a moment that falls on a
  frame is that frame.

  Raises:
    MjlabError: The rate is out of bounds, or fewer than three or too many frames would result.
  """
  check_value("resample: rate", rate, Rate)
  if math.isclose(rate, motion.rate, rel_tol=1e-9):
    return motion
  # The last moment counts also where rounding puts it just behind the last frame.
  count = math.floor(motion.duration * rate + 1e-6) + 1
  if count > MAX_FRAMES:
    raise MjlabError(f"motion '{motion.name}' has {count:,} frames at {rate:g} Hz; the limit is {MAX_FRAMES:,}")
  at = (torch.arange(count, dtype=torch.float64) * (motion.rate / rate)).clamp(max=motion.num_frames - 1)
  before = at.floor().long().clamp(max=motion.num_frames - 2)
  share = at - before

  def between(values: torch.Tensor) -> torch.Tensor:
    return torch.lerp(values[before], values[before + 1], share[:, None])

  return motion.changed(
    f"resampled from {motion.rate:g} to {rate:g} Hz",
    rate=float(rate),
    root_pos=between(motion.root_pos),
    root_quat=quat_slerp(motion.root_quat[before], motion.root_quat[before + 1], share),
    joint_pos=between(motion.joint_pos),
  )
