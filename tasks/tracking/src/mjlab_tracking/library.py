"""Many clips as one: in one buffer on the device, with weights, splits, and bins of about a second each."""

import dataclasses
import json
import math
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import torch
from mjlab_core.names import unknown

from mjlab_tracking.formats import read_motion
from mjlab_tracking.kinematics import Kinematics
from mjlab_tracking.motion import Motion, MotionError
from mjlab_tracking.timeline import angular_velocity, derivative, resample

INDEX = "library.json"
"""Optional file of a folder: {"clip.npz": {"weight": 2.0, "split": "test"}, ...}."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ClipEntry:
  """A clip of a library before it is placed on a robot."""

  path: Path
  weight: float = 1.0
  """How often a moment of it is a start, relative to one of the other clips."""
  split: str = "train"


def shipped_clips() -> dict[str, Path]:
  """The clips of this package by name."""
  folder = Path(str(files("mjlab_tracking") / "clips"))
  return {path.stem: path for path in sorted(folder.glob("*.npz"))}


def find_clips(motion: str, split: str | None = None) -> list[ClipEntry]:
  """The clips that a name means.

  Args:
    motion: Name of a clip that ships, path of a motion file, or path of a folder of them.
    split: Of a folder, only the clips of this split; None: all.

  Raises:
    MotionError: Nothing has that name, the folder has no clips of the split, or its index is wrong.
  """
  shipped, path = shipped_clips(), Path(motion)
  if motion in shipped:
    return [ClipEntry(path=shipped[motion])]
  if path.is_dir():
    entries = _folder(path)
    chosen = [entry for entry in entries if split is None or entry.split == split]
    if not chosen:
      splits = ", ".join(sorted({entry.split for entry in entries}))
      raise MotionError(
        f"{path}: no clip of split '{split}'; there is: {splits}" if entries else f"{path}: no .npz in it"
      )
    return chosen
  if path.is_file():
    if path.suffix != ".npz":
      raise MotionError(f"{path}: a clip to follow is an .npz; `convert-motion {path} --output FILE.npz` makes one")
    return [ClipEntry(path=path)]
  if (file := path.with_name(f"{path.name}.npz")).is_file():
    raise MotionError(f"motion '{motion}' is none of those that ship; the file is called {file}")
  raise MotionError(f"{unknown('motion', motion, list(shipped))} It may also be the path of an .npz or of a folder.")


def _folder(folder: Path) -> list[ClipEntry]:
  paths = sorted(folder.glob("*.npz"))
  index: dict[str, dict[str, object]] = {}
  if (file := folder / INDEX).is_file():
    try:
      index = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
      raise MotionError(f"{file}: not JSON ({error})") from error
    if not isinstance(index, dict) or not all(isinstance(value, dict) for value in index.values()):
      raise MotionError(f'{file}: expected {{"clip.npz": {{"weight": 1.0, "split": "train"}}, ...}}')
  for name, values in index.items():
    if name not in [path.name for path in paths]:
      raise MotionError(unknown("clip", name, [path.name for path in paths], owner=str(file)))
    for key in values:
      if key not in ("weight", "split"):
        raise MotionError(unknown("setting", key, ["weight", "split"], owner=f"{file}: {name}"))
  entries = []
  for path in paths:
    settings = index.get(path.name, {})
    weight = settings.get("weight", 1.0)
    if not isinstance(weight, int | float) or isinstance(weight, bool) or not (math.isfinite(weight) and weight > 0.0):
      raise MotionError(f"{file}: {path.name}: weight must be a positive number, is {weight!r}")
    entries.append(ClipEntry(path=path, weight=float(weight), split=str(settings.get("split", "train"))))
  return entries


class MotionLibrary:
  """Clips at one rate, placed on one robot, one frame a row. What never changes after build; all on the device.

  Args:
    motions: The clips.
    robot: Whose they are; derived quantities are computed where it says.
    bodies: Names of the bodies to keep, in order.
    rate: Frames per second, that of control [Hz].
    weights: One per clip; None: all the same.
    bin_seconds: About how long a bin is [s]; a clip has at least one.
    dtype: Precision of the rows.

  Raises:
    MotionError: No clip, one that does not fit the robot or is too short, or a name that the robot does not have.
  """

  def __init__(
    self,
    motions: Sequence[Motion],
    robot: Kinematics,
    bodies: Sequence[str],
    *,
    rate: float,
    weights: Sequence[float] | None = None,
    bin_seconds: float = 1.0,
    dtype: torch.dtype = torch.float32,
  ) -> None:
    if not motions:
      raise MotionError("a library needs at least one clip")
    for body in bodies:
      if body not in robot.body_names:
        raise MotionError(unknown("body", body, robot.body_names, owner="tracked bodies"))
    device = robot.device
    rows = [robot.body_names.index(body) for body in bodies]
    self.joint_names, self.body_names, self.rate = robot.joint_names, tuple(bodies), rate
    self.clip_names = tuple(motion.name for motion in motions)
    blocks, lengths, bins = [], [], []
    for motion in motions:
      motion = resample(motion, rate)
      blocks.append(_rows(motion, robot, rows).to(dtype))
      lengths.append(motion.num_frames)
      # A start needs a frame after it, so the last frame is in no bin of starts.
      bins.append(min(max(1, round((motion.num_frames - 1) / rate / bin_seconds)), motion.num_frames - 1))
    n, b = len(robot.joint_names), len(rows)
    widths = {"joint_pos": n, "joint_vel": n, "body_pos": 3 * b, "body_quat": 4 * b, "lin_vel": 3 * b, "ang_vel": 3 * b}
    starts = [sum(list(widths.values())[:i]) for i in range(len(widths))]
    self.columns = {name: slice(at, at + width) for (name, width), at in zip(widths.items(), starts, strict=True)}
    """Where each quantity is in a row; those of bodies are flattened."""
    self.table = torch.cat(blocks)
    """All frames of all clips, (frames, width)."""

    def whole(values: Sequence[int]) -> torch.Tensor:
      return torch.tensor(values, dtype=torch.int64, device=device)

    self.lengths = whole(lengths)
    """Frames of each clip, (clips,)."""
    self.offsets = whole([sum(lengths[:i]) for i in range(len(lengths))])
    """Row of the first frame of each clip, (clips,)."""
    self.bin_counts = whole(bins)
    """Bins of each clip, (clips,)."""
    self.bin_offsets = whole([sum(bins[:i]) for i in range(len(bins))])
    """Number of the first bin of each clip, (clips,)."""
    self.clip_of_bin = whole([clip for clip, count in enumerate(bins) for _ in range(count)])
    """(bins,)."""
    first, last = [], []
    for length, count in zip(lengths, bins, strict=True):
      edges = [(length - 1) * i // count for i in range(count + 1)]
      first += edges[:-1]
      last += edges[1:]
    self.bin_first, self.bin_end = whole(first), whole(last)
    """Frames of each bin within its clip: from the first up to, but without, the end, (bins,)."""
    weight = torch.tensor(list(weights or [1.0] * len(motions)), dtype=torch.float64, device=device)
    frames = (self.bin_end - self.bin_first).double()
    share = frames * weight[self.clip_of_bin]
    self.bin_share = (share / share.sum()).float()
    """Probability of each bin where every moment is as likely, but for the weights, (bins,)."""
    clip_share = torch.zeros_like(weight).index_add_(0, self.clip_of_bin, share)
    self.clip_share = (clip_share / clip_share.sum()).float()
    """The same of each clip, (clips,)."""

  @property
  def num_clips(self) -> int:
    return len(self.clip_names)

  @property
  def num_bins(self) -> int:
    return self.bin_first.numel()

  def bin_of(self, clip: torch.Tensor, frame: torch.Tensor) -> torch.Tensor:
    """Number of the bin of frames within clips, (...)."""
    count = self.bin_counts[clip]
    steps = (self.lengths[clip] - 1).clamp(min=1)
    # The edges of bins are rounded down, so a frame's bin is that of the next frame's share, rounded up, less one.
    within = ((frame + 1) * count - 1).div(steps, rounding_mode="floor")
    return self.bin_offsets[clip] + within.clamp(max=count - 1)

  def __repr__(self) -> str:
    seconds = float((self.lengths - 1).sum()) / self.rate
    return f"MotionLibrary({self.num_clips} clips, {seconds:.1f} s at {self.rate:g} Hz)"


def _rows(motion: Motion, robot: Kinematics, rows: list[int]) -> torch.Tensor:
  """Joints and bodies of each frame, (frames, width), on the robot's device."""

  def there(values: torch.Tensor) -> torch.Tensor:
    return values.to(robot.device)

  rate = motion.rate
  joint_pos = there(robot.columns_of(motion))
  joint_vel = derivative(joint_pos, rate)
  root_pos, root_quat = there(motion.root_pos), there(motion.root_quat)
  pos, quat = robot.poses(root_pos, root_quat, joint_pos)
  linear, angular = robot.velocities(
    pos, quat, derivative(root_pos, rate), angular_velocity(root_quat, rate), joint_vel
  )
  return torch.cat((joint_pos, joint_vel, *(part[:, rows].flatten(1) for part in (pos, quat, linear, angular))), 1)


def load_library(
  motion: str,
  robot: Kinematics,
  bodies: Sequence[str],
  *,
  rate: float,
  split: str | None = None,
  dtype: torch.dtype = torch.float32,
) -> MotionLibrary:
  """The clips that a name means (see `find_clips`) as a library.

  Raises:
    MotionError: See `find_clips`, `read_motion` and `MotionLibrary`.
  """
  entries = find_clips(motion, split)
  # Files of a folder have different names; what is written in them need not be.
  motions = [dataclasses.replace(read_motion(entry.path, robot), name=entry.path.stem) for entry in entries]
  return MotionLibrary(motions, robot, bodies, rate=rate, weights=[entry.weight for entry in entries], dtype=dtype)
