"""Recorder that turns the poses of a simulated robot into a clip."""

import torch

from mjlab_motions.kinematics import Kinematics
from mjlab_motions.motion import Motion


class MotionRecorder:
  """Recorder of the pose of one robot, frame by frame.

  Args:
    robot: The robot.
    rate: Frames per second [Hz].
  """

  def __init__(self, robot: Kinematics, *, rate: float) -> None:
    self.kinematics, self.rate = robot, rate
    self._rows: list[torch.Tensor] = []

  def add(self, root_pos: torch.Tensor, root_quat: torch.Tensor, joint_pos: torch.Tensor) -> None:
    """Add the next frame; copies it from the device.

    Args:
      root_pos: Position of the root's origin, (3,) [m].
      root_quat: Orientation of the root, (4,).
      joint_pos: In the order of the robot's joint names, (joints,) [rad or m].
    """
    self._rows.append(torch.cat((root_pos, root_quat, joint_pos)).double().cpu())

  def motion(self, name: str, *, source: str, license: str) -> Motion:
    """Return the frames so far, at least three."""
    table = torch.stack(self._rows)
    return Motion(
      name=name,
      rate=self.rate,
      root_body=self.kinematics.root_body,
      joint_names=self.kinematics.joint_names,
      root_pos=table[:, :3],
      root_quat=table[:, 3:7],
      joint_pos=table[:, 7:],
      source=source,
      license=license,
      history=("recorded from a simulation",),
    )
