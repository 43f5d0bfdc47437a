"""Motion clip: the pose of a floating robot at evenly spaced moments, with the names of its joints."""

import dataclasses
from typing import Annotated, Any

import torch
from mjlab_core.constraints import Items, Limits, check_fields
from mjlab_core.errors import MjlabError
from mjlab_core.io.files import printable

MIN_RATE, MAX_RATE = 1.0, 10_000.0
"""Limits of the frames per second of a clip [Hz]."""
MAX_FRAMES = 1_000_000
"""Limit of the frames of a clip: five and a half hours at 50 Hz."""
Rate = Annotated[float, Limits(ge=MIN_RATE, le=MAX_RATE)]
"""Frames per second [Hz]."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
  """One clip: root pose and joint positions. Velocities and body poses follow from these and a robot.

  Tensors are float64 on the CPU. Texts lose control characters and line breaks, because they may come from a file.

  Raises:
    MjlabError: Shapes do not fit one another, numbers are not finite, quaternions are not unit, a joint is named twice,
      or rate or length are out of bounds.
  """

  name: str
  rate: Rate
  """Frames per second, from `MIN_RATE` to `MAX_RATE` [Hz]."""
  root_body: str
  """Name of the floating body."""
  joint_names: Annotated[tuple[str, ...], Items(ge=0, unique=True)]
  root_pos: torch.Tensor
  """Position of the root's origin in the world, (frames, 3) [m]."""
  root_quat: torch.Tensor
  """Orientation of the root in the world, (frames, 4), unit, neighbours on the same hemisphere."""
  joint_pos: torch.Tensor
  """Absolute joint positions in the order of `joint_names`, (frames, joints) [rad or m]."""
  source: str = ""
  """Origin of the clip."""
  license: str = ""
  """Terms of use, an SPDX name if there is one."""
  history: tuple[str, ...] = ()
  """Changes made to the clip, oldest first."""

  def __post_init__(self) -> None:
    for field in ("name", "root_body", "source", "license"):
      object.__setattr__(self, field, printable(getattr(self, field)))
    object.__setattr__(self, "joint_names", tuple(printable(name) for name in self.joint_names))
    object.__setattr__(self, "history", tuple(printable(line) for line in self.history))
    check_fields(self, f"motion '{self.name}'")
    frames = self.root_pos.shape[0]
    for field, width in {"root_pos": 3, "root_quat": 4, "joint_pos": len(self.joint_names)}.items():
      value = getattr(self, field)
      self._check(value.shape == (frames, width), f"{field} has shape {tuple(value.shape)}, not ({frames}, {width})")
      self._check(bool(torch.isfinite(value).all()), f"{field} has numbers that are not finite")
    self._check(3 <= frames <= MAX_FRAMES, f"{frames} frames; allowed are 3 to {MAX_FRAMES:,}")
    norm = torch.linalg.vector_norm(self.root_quat, dim=-1)
    worst = int((norm - 1.0).abs().argmax())
    self._check(
      abs(float(norm[worst]) - 1.0) <= 0.01,
      f"root_quat has length {float(norm[worst]):.3f} in frame {worst}; these are probably other columns",
    )
    object.__setattr__(self, "root_quat", same_hemisphere(self.root_quat / norm[:, None]))

  def _check(self, holds: bool, problem: str) -> None:
    if not holds:
      raise MjlabError(f"motion '{self.name}': {problem}")

  @property
  def num_frames(self) -> int:
    """Number of frames."""
    return self.root_pos.shape[0]

  @property
  def duration(self) -> float:
    """Time from the first frame to the last [s]."""
    return (self.num_frames - 1) / self.rate

  def changed(self, remark: str, **fields: Any) -> "Motion":
    """Return a copy with other values, and a remark in its history."""
    return dataclasses.replace(self, history=(*self.history, remark), **fields)


def same_hemisphere(quat: torch.Tensor) -> torch.Tensor:
  """Return the same rotations, (frames, 4), with signs such that neighbours are never opposite."""
  flips = torch.where((quat[1:] * quat[:-1]).sum(-1) < 0.0, -1.0, 1.0).to(quat.dtype)
  signs = torch.cat((torch.ones(1, dtype=quat.dtype), torch.cumprod(flips, 0)))
  return quat * signs[:, None]
