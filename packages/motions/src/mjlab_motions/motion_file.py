"""Motion files: `.npz` archives without pickles, with metadata that describe their arrays."""

import os
from typing import Any

import msgspec
import numpy as np
import torch
from mjlab_core.errors import FileError
from mjlab_core.io.files import AtomicWrite, reading
from mjlab_core.io.npz import Npz

from mjlab_motions.clips import MAX_BYTES
from mjlab_motions.motion import Motion

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


class Metadata(msgspec.Struct):
  """Texts of a motion file, stored as JSON. Other fields are ignored."""

  format: str = ""
  version: int | None = None
  name: str = ""
  units: dict[str, str] = {}
  frames: dict[str, str] = {}
  source: str = ""
  license: str = ""
  history: list[str] = []


def save_motion(motion: Motion, path: str | os.PathLike[str], derived: dict[str, np.ndarray] | None = None) -> None:
  """Write a motion file. It appears whole or not at all; missing folders are created.

  Args:
    motion: Clip to write.
    path: The file, ending in `.npz`.
    derived: Arrays for other readers, by name, such as those of `derived_arrays`.
  """
  metadata = Metadata(
    format=FORMAT,
    version=VERSION,
    name=motion.name,
    units=UNITS,
    frames=FRAMES,
    source=motion.source,
    license=motion.license,
    history=list(motion.history),
  )
  arrays: dict[str, Any] = {
    "metadata": np.array(msgspec.json.encode(metadata).decode()),
    "fps": np.array([motion.rate]),
    "root_body": np.array(motion.root_body),
    "joint_names": np.array(motion.joint_names),
    "root_pos_w": motion.root_pos.numpy().astype(np.float32),
    "root_quat_w": motion.root_quat.numpy().astype(np.float32),
    "joint_pos": motion.joint_pos.numpy().astype(np.float32),
    **(derived or {}),
  }
  with AtomicWrite(path) as temporary, temporary.open("wb") as file:
    np.savez_compressed(file, **arrays)


def load_motion(path: str | os.PathLike[str]) -> Motion:
  """Return the clip of a motion file. `read_motion` reads other formats too.

  Raises:
    FileError: There is no such file, it is damaged or too large, or it is not of this format.
  """
  with reading("clip", path, MAX_BYTES) as file:
    archive = Npz(file, MAX_BYTES)
    if (metadata := metadata_of(archive)) is None:
      raise FileError(f"not a motion file, it has: {archive.names}; convert-motion may read it")
    return motion_in(archive, metadata)


def metadata_of(archive: Npz) -> Metadata | None:
  """Return the metadata of a motion file; None if the archive is of another format."""
  if "metadata" not in archive:
    return None
  try:
    text = archive.text("metadata")
    if msgspec.json.decode(text, type=_Format).format != FORMAT:
      return None
  except (FileError, msgspec.DecodeError, RecursionError):
    # Other projects may store something else under this name.
    return None
  return msgspec.json.decode(text, type=Metadata)


class _Format(msgspec.Struct):
  format: Any = ""


def motion_in(archive: Npz, metadata: Metadata) -> Motion:
  """Return the clip of an archive with these metadata.

  Raises:
    FileError: An array is missing, or the file is of a later version.
    MjlabError: Its numbers do not describe a motion.
  """
  if metadata.version != VERSION:
    raise FileError(f"written in version {metadata.version} of the format, this reads version {VERSION}")
  return Motion(
    name=metadata.name or archive.path.stem,
    rate=archive.number("fps"),
    root_body=archive.text("root_body"),
    joint_names=archive.words("joint_names"),
    root_pos=torch.from_numpy(archive.numbers("root_pos_w", ndim=2)),
    root_quat=torch.from_numpy(archive.numbers("root_quat_w", ndim=2)),
    joint_pos=torch.from_numpy(archive.numbers("joint_pos", ndim=2)),
    source=metadata.source,
    license=metadata.license,
    history=tuple(metadata.history),
  )
