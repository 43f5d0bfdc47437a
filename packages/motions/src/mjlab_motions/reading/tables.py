"""Clips as one table of root and joints: CSV files, and arrays of an `.npz`."""

import dataclasses
from pathlib import Path

import numpy as np
import torch
from mjlab_core.errors import FileError

from mjlab_motions.kinematics import Kinematics
from mjlab_motions.motion import Motion
from mjlab_motions.reading.statement import QuaternionOrder, Statement, mapped

UPRIGHT, TILTED = 0.9, 0.8
"""Mean height of the root's z axis, of 1, above which a reading is upright, and below which it clearly is not."""
MAX_LINE = 65_536
"""Limit of a line of a CSV [characters]."""


def from_csv(path: Path, robot: Kinematics, said: Statement) -> Motion:
  """Return the clip of a CSV: root position, root quaternion and joints, with or without a header.

  Raises:
    FileError: The file is too large or not a table of numbers, or something is neither stated nor provable.
  """
  lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
  if (longest := max(map(len, lines), default=0)) > MAX_LINE:
    raise FileError(f"a line has {longest:,} characters; the limit is {MAX_LINE:,}")
  # A header may be commented out; other comments do not describe columns.
  while lines and lines[0].lstrip().startswith("#") and "," not in lines[0]:
    del lines[0]
  header = [cell.strip().strip('"') for cell in lines[0].lstrip("# ").split(",")] if lines else []
  has_header = not all(_is_number(cell) for cell in header)
  if len(lines) <= has_header:
    raise FileError("the file has no numbers")
  table = np.loadtxt(lines[int(has_header) :], delimiter=",", ndmin=2)
  if has_header and said.joint_names is None:
    said = dataclasses.replace(said, joint_names=header[7:])
  return from_table(path, table, robot, said, said.rate_of(None))


def _is_number(cell: str) -> bool:
  try:
    float(cell)
  except ValueError:
    return False
  return True


def from_table(
  path: Path, table: np.ndarray, robot: Kinematics, said: Statement, rate: float, *, is_mujoco: bool = False
) -> Motion:
  """Return the clip of a table with the columns root position, root quaternion and joints.

  Args:
    path: File of the table, for messages.
    table: (frames, 7 + joints) [m, 1, rad or m].
    robot: Robot of the clip.
    said: Facts stated by the user. A missing order of quaternions is proven.
    rate: Frames per second [Hz].
    is_mujoco: The table is a `qpos`, whose quaternions begin with w.

  Raises:
    FileError: The number of columns is wrong, or the order of quaternions cannot be proven.
  """
  names = tuple(said.joint_names) if said.joint_names is not None else robot.joint_names
  if table.shape[1] != 7 + len(names):
    found = f"{table.shape[1]} columns, expected 7 of the root and {len(names)} of joints"
    raise FileError(f"{found}; name them with --joint-names, and with --joint-map for joints of the robot")
  order, proof = _quaternion_order(table[:, 3:7], said, is_mujoco)
  values = torch.from_numpy(table)
  motion = Motion(
    name=path.stem,
    rate=rate,
    root_body=robot.root_body,
    joint_names=names,
    root_pos=values[:, :3],
    root_quat=values[:, 3:7].roll(1 if order == "xyzw" else 0, 1),
    joint_pos=values[:, 7:],
    history=(f"read from {path.name}, {rate:g} Hz",),
  )
  return mapped(motion, robot, said).changed(f"quaternions {order} ({proof})")


def _quaternion_order(quaternions: np.ndarray, said: Statement, is_mujoco: bool) -> tuple[QuaternionOrder, str]:
  """Return the order of quaternions, and where it is known from.

  The order is proven if the root is upright in one reading and clearly not in the other. Angular speeds prove nothing,
  because neighbouring frames are as far apart in both readings.
  """
  if said.quaternion is not None:
    return said.quaternion, "stated"
  heights = _heights(quaternions)
  wrong, right = sorted(heights, key=lambda order: heights[order])
  is_proven = heights[right] >= UPRIGHT and heights[wrong] <= TILTED
  if is_mujoco:
    if is_proven and right == "xyzw":
      raise FileError("a qpos has w first, but only as xyzw it is upright; state it with --quaternion wxyz or xyzw")
    return "wxyz", "those of MuJoCo"
  if not is_proven:
    readings = ", ".join(f"{order} {height:+.2f}" for order, height in heights.items())
    why = f"cannot be proven (mean height of the root's z axis: {readings})"
    raise FileError(f"the order of its quaternions {why}; state it with --quaternion wxyz or xyzw")
  return right, "proven: only so it is upright"


def _heights(quaternions: np.ndarray) -> dict[QuaternionOrder, float]:
  """Return the mean height of the root's z axis in either reading of (frames, 4) numbers."""
  squares = torch.from_numpy(quaternions).square()
  squares = squares / squares.sum(1, keepdim=True)
  columns_of_xy: dict[QuaternionOrder, slice] = {"wxyz": slice(1, 3), "xyzw": slice(0, 2)}
  return {order: float((1.0 - 2.0 * squares[:, xy].sum(1)).mean()) for order, xy in columns_of_xy.items()}
