"""Changing clips: crop, mirror, join, smooth, put on the ground. Every function returns a new motion."""

import math
from collections.abc import Sequence

import torch
from mjlab_core.names import unknown
from mjlab_core.rotations import quat_apply, quat_conjugate, quat_mul, quat_slerp, quat_yaw

from mjlab_tracking.kinematics import Kinematics
from mjlab_tracking.motion import Motion, MotionError, same_hemisphere

SYMMETRY = 0.02
"""How far the axes of a joint and of its twin on the other side may be from mirror images [1]."""
BELOW_GROUND = 0.05
"""Share of frames that `to_ground` leaves with their lowest point below the ground."""


def crop(motion: Motion, start: float = 0.0, end: float | None = None) -> Motion:
  """The part between two times [s]; `end` None: to its end.

  Raises:
    MotionError: The times are not within the motion, or fewer than three frames are between them.
  """
  stop = motion.duration if end is None else end
  if not 0.0 <= start < stop <= motion.duration + 1e-9:
    raise MotionError(
      f"motion '{motion.name}' lasts {motion.duration:.3f} s; cannot crop it to {start:g} .. {stop:g} s"
    )
  first, last = math.ceil(start * motion.rate - 1e-6), math.floor(stop * motion.rate + 1e-6)
  part = slice(first, last + 1)
  return motion.changed(
    f"cropped to {start:g} .. {stop:g} s",
    root_pos=motion.root_pos[part],
    root_quat=motion.root_quat[part],
    joint_pos=motion.joint_pos[part],
  )


def mirror(motion: Motion, robot: Kinematics) -> Motion:
  """The motion seen in a mirror in the plane y = 0: left becomes right.

  A joint and its twin (left and right in their names) turn about axes that must be mirror images at the zero pose; a
  rotation about a becomes one about (-a_x, a_y, -a_z).

  Raises:
    MotionError: The robot is not symmetric: a joint has no twin, or one whose axis is no mirror image.
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
  """For each joint of the robot the column of its twin, and the sign that its value changes by.

  Raises:
    MotionError: As `mirror`.
  """
  model = robot.model
  zero = torch.zeros(1, len(robot.joint_names), dtype=torch.float64)
  root = torch.zeros(1, 3, dtype=torch.float64), torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
  quat = robot.poses(*root, zero)[1][0]
  rows = [robot.body_names.index(robot.local_name(model.body(model.jnt_bodyid[j]).name)) for j in robot.joint_ids]
  axes = quat_apply(quat[rows], torch.as_tensor(model.jnt_axis[robot.joint_ids]))
  slides = torch.as_tensor(model.jnt_type[robot.joint_ids]) == 2  # mjJNT_SLIDE: an arrow, not a rotation
  reflected = torch.where(slides[:, None], torch.tensor([1.0, -1.0, 1.0]), torch.tensor([-1.0, 1.0, -1.0])) * axes
  twins: list[int] = []
  signs: list[float] = []
  for i, name in enumerate(robot.joint_names):
    other = twin_name(name)
    if other not in robot.joint_names:
      raise MotionError(unknown("joint", other, robot.joint_names, owner=f"mirror: twin of '{name}'"))
    twin = robot.joint_names.index(other)
    along = float((axes[i] * reflected[twin]).sum())
    if abs(along) < 1.0 - SYMMETRY:
      raise MotionError(f"mirror: the axes of '{name}' and '{other}' are no mirror images; the robot is not symmetric")
    twins.append(twin)
    signs.append(math.copysign(1.0, along))
  return twins, signs


def twin_name(name: str) -> str:
  """The name of the same part on the other side: left and right exchanged; itself where there is neither."""
  parts = []
  for word in name.split("_"):
    parts.append({"left": "right", "right": "left", "l": "r", "r": "l", "L": "R", "R": "L"}.get(word, word))
  return "_".join(parts)


def concatenate(motions: Sequence[Motion], *, blend: float = 0.3) -> Motion:
  """One after the other; each is put where the one before ended, facing as it did then.

  Args:
    motions: At least one, of one robot and one rate; joints are placed by name.
    blend: Time over which the end of one becomes the start of the next [s].

  Raises:
    MotionError: Nothing to join, different joints or rates, or a clip that is shorter than the blend.
  """
  if not motions:
    raise MotionError("concatenate: no motion given")
  if not 0.0 < blend < math.inf:
    raise MotionError(f"concatenate: the blend must take time, got {blend:g} s")
  whole = motions[0]
  for motion in motions[1:]:
    same_joints = set(motion.joint_names) == set(whole.joint_names) and motion.root_body == whole.root_body
    if motion.rate != whole.rate or not same_joints:
      raise MotionError(f"'{whole.name}' and '{motion.name}' differ in rate or joints; resample and map them first")
    count = round(blend * whole.rate)
    if count < 1 or count >= min(whole.num_frames, motion.num_frames):
      raise MotionError(f"concatenate: a blend of {blend:g} s does not fit into '{whole.name}' and '{motion.name}'")
    joints = motion.joint_pos[:, [motion.joint_names.index(name) for name in whole.joint_names]]
    turn = quat_mul(quat_yaw(whole.root_quat[-count]), quat_conjugate(quat_yaw(motion.root_quat[0])))
    offset = whole.root_pos[-count] - quat_apply(turn, motion.root_pos[0])
    offset[2] = 0.0
    pos = quat_apply(turn.expand(motion.num_frames, 4), motion.root_pos) + offset
    quat = quat_mul(turn.expand(motion.num_frames, 4), motion.root_quat)
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
  """Every frame becomes the mean of its neighbours, weighted by a Gaussian in time.

  At the ends the window is cut off and its weights are raised to add up to one. The mean of rotations is the normalised
  mean of their quaternions.

  Args:
    motion: What to smooth.
    width: Standard deviation of the Gaussian [s].

  Raises:
    MotionError: The width is not positive.
  """
  if not 0.0 < width < math.inf:
    raise MotionError(f"smooth: width must be positive, got {width:g} s")
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
  """Moved up or down as a whole until in 95 of 100 frames the robot's lowest point is on or above the ground.

  A single number for the clip keeps jumps what they are; a few frames that dig deeper do not leave the rest in the air.
  """
  pos, quat = robot.poses(motion.root_pos, motion.root_quat, robot.columns_of(motion))
  lowest = robot.lowest_points(pos, quat)[0][..., 2].amin(1)
  shift = -float(torch.quantile(lowest, BELOW_GROUND))
  return motion.changed(
    f"moved {shift:+.4f} m onto the ground",
    root_pos=motion.root_pos + torch.tensor([0.0, 0.0, shift], dtype=torch.float64),
  )
