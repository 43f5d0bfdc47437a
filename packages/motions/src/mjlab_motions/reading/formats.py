"""Reading of clips in the formats of the field: CSV of root and joints, and four kinds of `.npz`.

A fact that a file lacks must be stated, or is proven from the file's numbers. Nothing is assumed: a clip with a wrong
rate plays at the wrong speed, one with a wrong quaternion order lies on its back.
"""

import dataclasses
import os

import numpy as np
import torch
from mjlab_core.errors import FileError
from mjlab_core.io.files import reading
from mjlab_core.io.npz import Npz

from mjlab_motions.clips import MAX_BYTES
from mjlab_motions.kinematics import Kinematics
from mjlab_motions.motion import Motion
from mjlab_motions.motion_file import metadata_of, motion_in
from mjlab_motions.reading.placing import check_bodies, from_seven_keys
from mjlab_motions.reading.statement import Statement, mapped
from mjlab_motions.reading.tables import from_csv, from_table


def read_motion(path: str | os.PathLike[str], robot: Kinematics, said: Statement | None = None) -> Motion:
  """Read a clip and place it on a robot.

  Args:
    path: `.csv` (root position, root quaternion, joints), or `.npz`: a motion file of mjlab-motions, the seven keys of
      BeyondMimic and mjlab, arrays with `joint_names`, or a MuJoCo rollout with `qpos`.
    robot: Robot of the clip.
    said: Facts that the file lacks.

  Raises:
    FileError: The file cannot be read or is too large, something is neither stated nor provable, the numbers do not
      describe a motion, or the motion does not fit the robot.
  """
  said = said or Statement()
  with reading("clip", path, MAX_BYTES) as file:
    if file.suffix not in (".csv", ".npz"):
      raise FileError("expected .csv or .npz; convert other files without pickles to one of them")
    motion = from_csv(file, robot, said) if file.suffix == ".csv" else _from_npz(Npz(file, MAX_BYTES), robot, said)
    robot.columns_of(motion)
    return motion


def _from_npz(archive: Npz, robot: Kinematics, said: Statement) -> Motion:
  path = archive.path
  if (metadata := metadata_of(archive)) is not None:
    motion = motion_in(archive, metadata)
    said.rate_of(motion.rate)
    if said.quaternion == "xyzw":
      raise FileError("the file has w first, --quaternion says xyzw")
    motion = mapped(motion, robot, said)
    if "body_pos_w" in archive and said.joint_map is None:
      check_bodies(archive, motion, robot)
    return motion
  if "qpos" in archive:
    qpos = archive.numbers("qpos", ndim=2)
    return from_table(path, qpos, robot, said, _rate(archive, said, len(qpos)), is_mujoco=True)
  found = {
    kind: archive.words(kind)
    for kind in ("joint_names", "body_names")
    if kind in archive and getattr(said, kind) is None
  }
  said = dataclasses.replace(said, **found)
  if "joint_pos" in archive:
    table = archive.numbers("joint_pos", ndim=2)
    rate = _rate(archive, said, len(table))
    joints = len(robot.joint_names if said.joint_names is None else said.joint_names)
    # Some files have the root in front of the joints and then need no bodies.
    if "body_pos_w" not in archive or table.shape[1] == 7 + joints:
      return from_table(path, table, robot, said, rate)
    return from_seven_keys(archive, torch.from_numpy(table), robot, said, rate)
  raise FileError(f"lacks joint_pos or qpos, it has: {archive.names}")


def _rate(archive: Npz, said: Statement, frames: int) -> float:
  """Return the frames per second that an archive contains or the user states [Hz]."""
  if "fps" in archive:
    return said.rate_of(archive.number("fps"))
  if "times" in archive and len(times := archive.column("times")) == frames > 1:
    with np.errstate(all="ignore"):
      steps = np.diff(times)
    if not (steps.min() > 0.0 and np.ptp(steps) <= 1e-3 * steps.mean()):
      raise FileError(f"its times are not evenly spaced: steps of {steps.min():.4g} to {steps.max():.4g} s")
    return said.rate_of(float(1.0 / steps.mean()))
  return said.rate_of(None)
