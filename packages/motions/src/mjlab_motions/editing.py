"""Edits of clips: crop, mirror, join, smooth, put on the ground. Every function returns a new motion."""

import math
from collections.abc import Sequence

import torch
from mjlab_core.constraints import Positive, check_value
from mjlab_core.errors import MjlabError
from mjlab_core.names import check_name
from mjlab_core.rotations import quat_apply, quat_conjugate, quat_mul, quat_slerp, quat_yaw

from mjlab_motions.kinematics import Kinematics
from mjlab_motions.motion import Motion, same_hemisphere

SYMMETRY = 0.02
"""Largest deviation of the axes of a joint and of its twin on the other side from mirror images [1]."""
BELOW_GROUND = 0.05
"""Share of frames that `to_ground` leaves with their lowest point below the ground."""


def crop(motion: Motion, start: float = 0.0, end: float | None = None) -> Motion:
  """Return the part between two times [s]; without `end`, up to the last frame.

  Raises:
    MjlabError: The times are not within the motion, or fewer than three frames are between them.
  """
  stop = motion.duration if end is None else end
  if not 0.0 <= start < stop <= motion.duration + 1e-9:
    raise MjlabError(f"motion '{motion.name}' lasts {motion.duration:.3f} s; cannot crop it to {start:g} .. {stop:g} s")
  first, last = math.ceil(start * motion.rate - 1e-6), math.floor(stop * motion.rate + 1e-6)
  part = slice(first, last + 1)
  return motion.changed(
    f"cropped to {start:g} .. {stop:g} s",
    root_pos=motion.root_pos[part],
    root_quat=motion.root_quat[part],
    joint_pos=motion.joint_pos[part],
  )


def mirror(motion: Motion, robot: Kinematics) -> Motion:
  """Return the motion mirrored in the plane y = 0: left becomes right.

  A joint and its twin (left and right in their names) turn about axes that must be mirror images at the zero pose; a
  rotation about a becomes one about (-a_x, a_y, -a_z).

  Raises:
    MjlabError: The robot is not symmetric: a joint has no twin, or the axes are not mirror images.
  """
  joints = robot.columns_of(motion)
  twins, signs = mirrored_joints(robot)
  values = joints[:, twins] * torch.tensor(signs, dtype=joints.dtype)
  return motion.changed(
    "mirrored",
    root_pos=motion.root_pos * torch.tensor([1.0, -1.0, 1.0], dtype=joints.dtype),
    root_quat=motion.root_quat * torch.tensor([1.0, -1.0, 1.0, -1.0], dtype=joints.dtype),
    joint_names=robot.joint_names,
    joint_pos=values,
  )


def mirrored_joints(robot: Kinematics) -> tuple[list[int], list[float]]:
  """Return for each joint of the robot the column of its twin, and the sign of its value there.

  Raises:
    MjlabError: See `mirror`.
  """
  model = robot.model
  zero = torch.zeros(1, len(robot.joint_names), dtype=torch.float64)
  root = torch.zeros(1, 3, dtype=torch.float64), torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
  quat = robot.poses(*root, zero)[1][0]
  rows = [robot.rows[body] for body in model.jnt_bodyid[robot.joint_ids].tolist()]
  axes = quat_apply(quat[rows], torch.as_tensor(model.jnt_axis[robot.joint_ids]))
  slides = torch.as_tensor(model.jnt_type[robot.joint_ids]) == 2  # mjJNT_SLIDE: an arrow, not a rotation
  reflected = torch.where(slides[:, None], torch.tensor([1.0, -1.0, 1.0]), torch.tensor([-1.0, 1.0, -1.0])) * axes
  twins: list[int] = []
  signs: list[float] = []
  for i, name in enumerate(robot.joint_names):
    other = twin_name(name)
    check_name("joint", other, robot.joint_names, f"mirror: twin of '{name}'")
    twin = robot.joint_names.index(other)
    along = float((axes[i] * reflected[twin]).sum())
    if abs(along) < 1.0 - SYMMETRY:
      raise MjlabError(f"mirror: the axes of '{name}' and '{other}' are not mirror images; the robot is not symmetric")
    twins.append(twin)
    signs.append(math.copysign(1.0, along))
  return twins, signs


def twin_name(name: str) -> str:
  """Return the name of the same part on the other side; a name without left or right is returned unchanged."""
  other = {"left": "right", "right": "left", "l": "r", "r": "l", "L": "R", "R": "L"}
  return "_".join(other.get(word, word) for word in name.split("_"))


def concatenate(motions: Sequence[Motion], *, blend: float = 0.3) -> Motion:
  """Return the clips one after the other; each starts at the position and heading at which the previous one ends.

  Args:
    motions: At least one, of one robot and one rate; joints are placed by name.
    blend: Duration of the transition from the end of one to the start of the next [s].

  Raises:
    MjlabError: Different joints or rates, or a clip that is shorter than the blend.
  """
  check_value("concatenate: blend", blend, Positive)
  whole = motions[0]
  for motion in motions[1:]:
    same_joints = set(motion.joint_names) == set(whole.joint_names) and motion.root_body == whole.root_body
    if motion.rate != whole.rate or not same_joints:
      raise MjlabError(f"'{whole.name}' and '{motion.name}' differ in rate or joints; resample and map them first")
    count = round(blend * whole.rate)
    if count < 1 or count >= min(whole.num_frames, motion.num_frames):
      raise MjlabError(f"concatenate: a blend of {blend:g} s does not fit into '{whole.name}' and '{motion.name}'")
    joints = motion.joint_pos[:, [motion.joint_names.index(name) for name in whole.joint_names]]
    turn = quat_mul(quat_yaw(whole.root_quat[-count]), quat_conjugate(quat_yaw(motion.root_quat[0])))
    offset = whole.root_pos[-count] - quat_apply(turn, motion.root_pos[0])
    offset[2] = 0.0
    pos, quat = quat_apply(turn, motion.root_pos) + offset, quat_mul(turn, motion.root_quat)
    # Smooth at both ends, so that speeds do not jump.
    share = torch.linspace(0.0, 1.0, count, dtype=torch.float64)
    share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    middle_quat = quat_slerp(whole.root_quat[-count:], quat[:count], share)

    def joined(a: torch.Tensor, b: torch.Tensor, count: int = count, share: torch.Tensor = share) -> torch.Tensor:
      return torch.cat((a[:-count], torch.lerp(a[-count:], b[:count], share[:, None]), b[count:]))

    whole = whole.changed(
      f"followed by {motion.name}",
      root_pos=joined(whole.root_pos, pos),
      root_quat=torch.cat((whole.root_quat[:-count], middle_quat, quat[count:])),
      joint_pos=joined(whole.joint_pos, joints),
    )
  return whole


def smooth(motion: Motion, width: float) -> Motion:
  """Return the motion with each frame replaced by the mean of its neighbours, weighted by a Gaussian in time.

  At the ends the window is cut off and its weights are scaled to add up to one. The mean of rotations is the normalised
  mean of their quaternions.

  Args:
    motion: Clip to smooth.
    width: Standard deviation of the Gaussian [s].

  Raises:
    MjlabError: The width is not positive.
  """
  check_value("smooth: width", width, Positive)
  reach = min(math.ceil(4.0 * width * motion.rate), motion.num_frames - 1)
  at = torch.arange(-reach, reach + 1, dtype=torch.float64)
  kernel = torch.exp(-0.5 * (at / (width * motion.rate)) ** 2)[None, None]
  total = torch.nn.functional.conv1d(torch.ones(1, 1, motion.num_frames, dtype=torch.float64), kernel, padding=reach)

  def mean(values: torch.Tensor) -> torch.Tensor:
    return (torch.nn.functional.conv1d(values.T[:, None], kernel, padding=reach) / total)[:, 0].T

  quat = mean(same_hemisphere(motion.root_quat))
  return motion.changed(
    f"smoothed over {width:g} s",
    root_pos=mean(motion.root_pos),
    root_quat=quat / torch.linalg.vector_norm(quat, dim=-1, keepdim=True),
    joint_pos=mean(motion.joint_pos),
  )


def to_ground(motion: Motion, robot: Kinematics) -> Motion:
  """Return the motion raised or lowered so that in 95 of 100 frames the lowest point is on or above the ground.

  One shift for the whole clip preserves jumps. The few frames that dig deeper do not lift the rest into the air.
  """
  pos, quat = robot.poses(motion.root_pos, motion.root_quat, robot.columns_of(motion))
  lowest = robot.lowest_points(pos, quat)[0][..., 2].amin(1)
  shift = -float(torch.quantile(lowest, BELOW_GROUND))
  return motion.changed(
    f"moved {shift:+.4f} m onto the ground",
    root_pos=motion.root_pos + torch.tensor([0.0, 0.0, shift], dtype=torch.float64),
  )
