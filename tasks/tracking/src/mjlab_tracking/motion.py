"""A motion clip: how a floating robot stands at evenly spaced moments, with the names that make it readable anywhere.

A motion file is a `.npz` without pickles. What a clip *is* are root pose and joint positions; velocities and body poses
follow from these and a robot, so they are derived (see `timeline` and `kinematics`) and stored for other readers only.
"""

import dataclasses
import json
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

FORMAT = "mjlab-motion"
VERSION = 1
UNITS = {"length": "m", "angle": "rad", "time": "s"}
FRAMES = {
  "quaternions": "unit, (w, x, y, z)",
  "root_pos_w, root_quat_w": "pose of the root body's origin in the world, z up",
  "body_pos_w, body_quat_w": "pose of each body's origin in the world",
  "body_lin_vel_w, body_ang_vel_w": "velocity of each body at its origin, world axes",
  "joint_pos, joint_vel": "absolute, in the order of joint_names",
}


class MotionError(ValueError):
  """A motion that cannot be read, placed on a robot or written; the message says what is wrong with which file."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
  """One clip. Tensors are float64 on the CPU.

  Raises:
    MotionError: shapes that do not fit one another, numbers that are not finite, quaternions that are not unit, a rate
      that is not positive, or fewer than three frames.
  """

  name: str
  rate: float
  """Frames per second [Hz]."""
  root_body: str
  """Name of the floating body."""
  joint_names: tuple[str, ...]
  root_pos: torch.Tensor
  """Position of the root's origin in the world, (frames, 3) [m]."""
  root_quat: torch.Tensor
  """Orientation of the root in the world, (frames, 4), unit, neighbours on the same hemisphere."""
  joint_pos: torch.Tensor
  """Absolute joint positions in the order of `joint_names`, (frames, joints) [rad or m]."""
  source: str = ""
  """Where it comes from."""
  license: str = ""
  """Under what terms it may be used, an SPDX name where there is one."""
  history: tuple[str, ...] = ()
  """What was done to it, oldest first."""

  def __post_init__(self) -> None:
    shapes = {
      "root_pos": (self.root_pos, 3),
      "root_quat": (self.root_quat, 4),
      "joint_pos": (self.joint_pos, len(self.joint_names)),
    }
    frames = self.root_pos.shape[0]
    for field, (value, width) in shapes.items():
      if value.shape != (frames, width):
        raise MotionError(f"motion '{self.name}': {field} has shape {tuple(value.shape)}, expected ({frames}, {width})")
      if not bool(torch.isfinite(value).all()):
        raise MotionError(f"motion '{self.name}': {field} has numbers that are not finite")
    if frames < 3:
      raise MotionError(f"motion '{self.name}': {frames} frames are too few, velocities need three")
    if not (np.isfinite(self.rate) and self.rate > 0):
      raise MotionError(f"motion '{self.name}': rate is {self.rate} Hz, it must be positive")
    if len(set(self.joint_names)) < len(self.joint_names):
      raise MotionError(f"motion '{self.name}': a joint is named twice")
    norm = torch.linalg.vector_norm(self.root_quat, dim=-1)
    worst = int((norm - 1.0).abs().argmax())
    if abs(float(norm[worst]) - 1.0) > 0.01:
      raise MotionError(
        f"motion '{self.name}': root_quat has length {float(norm[worst]):.3f} in frame {worst}; it is no rotation, so "
        "these are probably other columns"
      )
    object.__setattr__(self, "root_quat", same_hemisphere(self.root_quat / norm[:, None]))

  @property
  def num_frames(self) -> int:
    return self.root_pos.shape[0]

  @property
  def duration(self) -> float:
    """Time from the first frame to the last [s]."""
    return (self.num_frames - 1) / self.rate

  def changed(self, what: str, **fields: Any) -> "Motion":
    """A copy with other values, which says so in its history."""
    return dataclasses.replace(self, history=(*self.history, what), **fields)


def same_hemisphere(quat: torch.Tensor) -> torch.Tensor:
  """The same rotations, (frames, 4), with signs such that neighbours are never opposite."""
  flips = torch.where((quat[1:] * quat[:-1]).sum(-1) < 0.0, -1.0, 1.0).to(quat.dtype)
  signs = torch.cat((torch.ones(1, dtype=quat.dtype), torch.cumprod(flips, 0)))
  return quat * signs[:, None]


def save_motion(motion: Motion, path: str | os.PathLike[str], derived: dict[str, np.ndarray] | None = None) -> None:
  """Write a motion file; it appears whole or not at all, in a folder that is made where it is missing.

  Args:
    motion: What to write.
    path: The file, ending in `.npz`.
    derived: Arrays for other readers, by name, such as those of `kinematics.derived_arrays`.

  Raises:
    MotionError: The path does not end in `.npz`.
  """
  path = Path(path)
  if path.suffix != ".npz":
    raise MotionError(f"{path}: a motion file ends in .npz")
  metadata = {
    "format": FORMAT,
    "version": VERSION,
    "name": motion.name,
    "units": UNITS,
    "frames": FRAMES,
    "source": motion.source,
    "license": motion.license,
    "history": list(motion.history),
  }
  arrays: dict[str, Any] = {
    "metadata": np.array(json.dumps(metadata)),
    "fps": np.array([motion.rate]),
    "root_body": np.array(motion.root_body),
    "joint_names": np.array(motion.joint_names),
    "root_pos_w": motion.root_pos.numpy().astype(np.float32),
    "root_quat_w": motion.root_quat.numpy().astype(np.float32),
    "joint_pos": motion.joint_pos.numpy().astype(np.float32),
    **(derived or {}),
  }
  path.parent.mkdir(parents=True, exist_ok=True)
  temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp.npz")
  try:
    np.savez_compressed(temporary, **arrays)
    os.replace(temporary, path)
  finally:
    temporary.unlink(missing_ok=True)


def load_motion(path: str | os.PathLike[str]) -> Motion:
  """Read a motion file of ours. `formats.read_motion` reads others too.

  Raises:
    MotionError: There is no such file, it is damaged, or it is not of this format.
  """
  return motion_from_arrays(load_arrays(Path(path)), Path(path))


def motion_from_arrays(arrays: dict[str, np.ndarray], path: Path) -> Motion:
  """The motion in the arrays of one of our files.

  Raises:
    MotionError: Something is missing, or it was written by a later version.
  """
  if not is_ours(arrays):
    raise MotionError(
      f"{path}: not a motion file of this project, it has: {', '.join(arrays)}; convert-motion reads it"
    )
  metadata = _metadata(arrays)
  if (version := metadata.get("version")) != VERSION:
    raise MotionError(f"{path}: written in version {version} of the format, this reads version {VERSION}")
  needed = ("fps", "root_body", "joint_names", "root_pos_w", "root_quat_w", "joint_pos")
  if missing := [name for name in needed if name not in arrays]:
    raise MotionError(f"{path}: lacks {', '.join(missing)}, it has: {', '.join(arrays)}")
  history = metadata.get("history")
  return Motion(
    name=str(metadata.get("name") or path.stem),
    rate=rate_of(arrays, path),
    root_body=str(arrays["root_body"]),
    joint_names=names_in(arrays, "joint_names", path),
    root_pos=torch.from_numpy(numbers_in(arrays, "root_pos_w", path, ndim=2)),
    root_quat=torch.from_numpy(numbers_in(arrays, "root_quat_w", path, ndim=2)),
    joint_pos=torch.from_numpy(numbers_in(arrays, "joint_pos", path, ndim=2)),
    source=str(metadata.get("source", "")),
    license=str(metadata.get("license", "")),
    history=tuple(str(line) for line in history) if isinstance(history, list) else (),
  )


def is_ours(arrays: dict[str, np.ndarray]) -> bool:
  """Whether these are the arrays of a motion file of this project."""
  return _metadata(arrays).get("format") == FORMAT


def load_arrays(path: Path) -> dict[str, np.ndarray]:
  """All arrays of a `.npz`, without running code.

  Raises:
    MotionError: There is no such file, or it is damaged or holds Python objects.
  """
  if not path.is_file():
    raise MotionError(f"{path}: no such file")
  if not zipfile.is_zipfile(path):
    raise MotionError(f"{path}: not a readable .npz (it is none, or its end is missing)")
  try:
    with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
      # A zip may hold other things, which come as bytes.
      return {name: value for name in file.files if isinstance(value := file[name], np.ndarray)}
  except (ValueError, OSError, EOFError, KeyError, AttributeError) as error:
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    raise MotionError(f"{path}: not a readable .npz ({reason})") from error
  except Exception as error:  # zipfile and zlib have errors of their own
    raise MotionError(f"{path}: damaged ({error})") from error


def numbers_in(arrays: dict[str, np.ndarray], name: str, path: Path, *, ndim: int) -> NDArray[np.float64]:
  """An array of a file, as numbers with `ndim` axes.

  Raises:
    MotionError: It holds something else, or has other axes.
  """
  value = arrays[name]
  if value.dtype.kind not in "fiu" or value.ndim != ndim:
    raise MotionError(f"{path}: {name} has shape {value.shape} and type {value.dtype}, expected {ndim}-d numbers")
  return value.astype(np.float64)


def names_in(arrays: dict[str, np.ndarray], name: str, path: Path) -> tuple[str, ...]:
  """A list of words of a file.

  Raises:
    MotionError: It is no list of words.
  """
  value = arrays[name]
  if value.dtype.kind not in "US" or value.ndim != 1:
    raise MotionError(f"{path}: {name} has shape {value.shape} and type {value.dtype}, expected a list of names")
  return tuple(value.astype(str).tolist())


def rate_of(arrays: dict[str, np.ndarray], path: Path) -> float:
  """The number under `fps` [Hz].

  Raises:
    MotionError: It is not one number.
  """
  value = arrays["fps"]
  if value.size != 1:
    raise MotionError(f"{path}: fps has shape {value.shape}, expected one number")
  return float(numbers_in({"fps": value.reshape(1)}, "fps", path, ndim=1)[0])


def _metadata(arrays: dict[str, np.ndarray]) -> dict[str, Any]:
  if "metadata" not in arrays or arrays["metadata"].dtype.kind != "U":
    return {}
  try:
    metadata = json.loads(str(arrays["metadata"]))
  except ValueError:
    return {}
  return metadata if isinstance(metadata, dict) else {}
