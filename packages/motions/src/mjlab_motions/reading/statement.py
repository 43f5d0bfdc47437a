"""Facts about a clip's file that the user states because the file does not."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

import torch
from mjlab_core.errors import FileError
from mjlab_core.names import check_name

from mjlab_motions.kinematics import Kinematics
from mjlab_motions.motion import Motion

QuaternionOrder = Literal["wxyz", "xyzw"]
JointMap = Mapping[str, str | float]
"""Source of each joint of the robot: the name of a column, or a constant position [rad or m]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Statement:
  """Facts stated by the user. None: the file says it, or its numbers prove it."""

  rate: float | None = None
  """Frames per second [Hz]."""
  quaternion: QuaternionOrder | None = None
  """Order of quaternions in the file."""
  joint_names: Sequence[str] | None = None
  """Names of the joint columns, in order."""
  body_names: Sequence[str] | None = None
  """Names of the bodies of a seven-key `.npz`, in order."""
  joint_map: JointMap | None = None
  """Source of each robot joint. None: the file uses the robot's names."""

  def rate_of(self, found: float | None) -> float:
    """Return the rate that a file contains (None: it contains none) or the user states [Hz].

    Raises:
      FileError: Neither does, or they differ.
    """
    if found is None:
      if self.rate is None:
        raise FileError("it does not contain its rate; state it with --rate")
      return self.rate
    if self.rate is not None and not abs(found - self.rate) <= 1e-3 * found:
      raise FileError(f"the file says {found:g} Hz, --rate says {self.rate:g}")
    return found


def mapped(motion: Motion, robot: Kinematics, said: Statement) -> Motion:
  """Return the motion with the joints of the robot, through the stated joint map.

  Raises:
    UnknownNameError: The map names a joint or a column that does not exist.
  """
  if said.joint_map is None:
    return motion
  for joint in said.joint_map:
    check_name("joint", joint, robot.joint_names, "joint map: robot")
  columns: list[torch.Tensor] = []
  for joint in robot.joint_names:
    source = said.joint_map.get(joint, joint)
    if isinstance(source, str):
      check_name("column", source, motion.joint_names, f"joint map: joint '{joint}': motion '{motion.name}'")
      columns.append(motion.joint_pos[:, motion.joint_names.index(source)])
    else:
      columns.append(torch.full((motion.num_frames,), float(source), dtype=torch.float64))
  return motion.changed(
    "joints renamed", joint_names=robot.joint_names, joint_pos=torch.stack(columns, 1), root_body=robot.root_body
  )
