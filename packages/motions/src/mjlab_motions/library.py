"""Many clips in one buffer on the device, with weights, splits, and bins of about a second each."""

import dataclasses
from collections.abc import Sequence
from itertools import accumulate

import torch
from mjlab_core.names import check_name

from mjlab_motions.clips import find_clips
from mjlab_motions.kinematics import Kinematics
from mjlab_motions.motion import Motion
from mjlab_motions.reading.formats import read_motion
from mjlab_motions.timeline import resample


class MotionLibrary:
  """Clips at one rate, placed on one robot, one frame per row. Constant after build, and all on the device.

  Args:
    motions: The clips, at least one.
    robot: Robot of all clips. Derived quantities are computed on its device.
    bodies: Names of the bodies to keep, in order.
    rate: Frames per second of the buffer, usually the control rate [Hz].
    weights: One per clip; None: equal weights.
    dtype: Precision of the rows.

  Raises:
    MjlabError: A clip does not fit the robot or is too short.
    UnknownNameError: The robot lacks a body.
  """

  def __init__(
    self,
    motions: Sequence[Motion],
    robot: Kinematics,
    bodies: Sequence[str],
    *,
    rate: float,
    weights: Sequence[float] | None = None,
    dtype: torch.dtype = torch.float32,
  ) -> None:
    for body in bodies:
      check_name("body", body, robot.body_names, "tracked bodies")
    device = robot.device
    rows = [robot.body_names.index(body) for body in bodies]
    self.joint_names, self.body_names, self.rate = robot.joint_names, tuple(bodies), rate
    self.clip_names = tuple(motion.name for motion in motions)
    motions = [resample(motion, rate) for motion in motions]
    n, b = len(robot.joint_names), len(rows)
    widths = {"joint_pos": n, "joint_vel": n, "body_pos": 3 * b, "body_quat": 4 * b, "lin_vel": 3 * b, "ang_vel": 3 * b}
    ends = accumulate(widths.values())
    self.columns = {name: slice(end - width, end) for (name, width), end in zip(widths.items(), ends, strict=True)}
    """Columns of each quantity in a row; those of bodies are flattened."""
    self.table = torch.cat([_rows(motion, robot, rows).to(dtype) for motion in motions])
    """All frames of all clips, (frames, width)."""

    # A start needs a frame after it, so the last frame is in no bin of starts.
    steps = torch.tensor([motion.num_frames - 1 for motion in motions], device=device)
    self.lengths = steps + 1
    """Frames of each clip, (clips,)."""
    self.offsets = self.lengths.cumsum(0) - self.lengths
    """Row of the first frame of each clip, (clips,)."""
    self.bin_counts = (steps.double() / rate).round().long().clamp(min=1).minimum(steps)
    """Bins of each clip, about one for each second, (clips,)."""
    self.clip_of_bin = torch.arange(len(motions), device=device).repeat_interleave(self.bin_counts)
    """Clip of each bin, (bins,)."""
    steps, count = steps[self.clip_of_bin], self.bin_counts[self.clip_of_bin]
    bins = torch.arange(count.numel(), device=device) - (self.bin_counts.cumsum(0) - self.bin_counts)[self.clip_of_bin]
    self.bin_first, self.bin_end = bins * steps // count, (bins + 1) * steps // count
    """Frames of each bin within its clip: the first, and the one after the last, (bins,)."""
    self._bin_rows = self.offsets[self.clip_of_bin] + self.bin_first
    weight = torch.tensor(list(weights or [1.0] * len(motions)), dtype=torch.float64, device=device)
    frames = (self.bin_end - self.bin_first).double()
    share = frames * weight[self.clip_of_bin]
    self.bin_share = (share / share.sum()).float()
    """Probability of each bin if moments are equally likely up to the weights, (bins,)."""
    clip_share = torch.zeros_like(weight).index_add_(0, self.clip_of_bin, share)
    self.clip_share = (clip_share / clip_share.sum()).float()
    """Probability of each clip under the same rule, (clips,)."""

  @property
  def num_clips(self) -> int:
    """Number of clips."""
    return len(self.clip_names)

  @property
  def num_bins(self) -> int:
    """Number of bins."""
    return self.bin_first.numel()

  def bin_of(self, clip: torch.Tensor, frame: torch.Tensor) -> torch.Tensor:
    """Return the number of the bin of frames within clips, (...)."""
    return torch.searchsorted(self._bin_rows, self.offsets[clip] + frame, right=True) - 1

  def part(self, rows: torch.Tensor, name: str) -> torch.Tensor:
    """Return a quantity of `columns` in rows of the table: (n, joints), or (n, bodies, 3 or 4) for one of bodies."""
    values = rows[:, self.columns[name]]
    return values if name.startswith("joint") else values.unflatten(1, (len(self.body_names), -1))

  def __repr__(self) -> str:
    seconds = float((self.lengths - 1).sum()) / self.rate
    return f"MotionLibrary({self.num_clips} clips, {seconds:.1f} s at {self.rate:g} Hz)"


def _rows(motion: Motion, robot: Kinematics, rows: list[int]) -> torch.Tensor:
  """Return joints and bodies of each frame, (frames, width), on the robot's device."""
  joint_pos, joint_vel, *bodies = robot.states(motion)
  return torch.cat((joint_pos, joint_vel, *(part[:, rows].flatten(1) for part in bodies)), 1)


def load_library(
  motion: str,
  robot: Kinematics,
  bodies: Sequence[str],
  *,
  rate: float,
  split: str | None = None,
  dtype: torch.dtype = torch.float32,
) -> MotionLibrary:
  """Return the clips that a name refers to, see `find_clips`, as a library.

  Raises:
    MjlabError: See `find_clips`, `read_motion` and `MotionLibrary`.
  """
  entries = find_clips(motion, split)
  # Files of a folder have different names; the names stored in them may be equal.
  motions = [dataclasses.replace(read_motion(entry.path, robot), name=entry.path.stem) for entry in entries]
  return MotionLibrary(motions, robot, bodies, rate=rate, weights=[entry.weight for entry in entries], dtype=dtype)
