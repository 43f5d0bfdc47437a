"""Reading clips as the field writes them: CSV of root and joints, and four kinds of `.npz`.

What a file does not say must be stated or is proven from its numbers. Nothing is assumed: a wrong rate plays at the
wrong speed, a wrong quaternion order lies on its back, a wrong body order trains towards nothing.
"""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from mjlab_core.names import unknown
from mjlab_core.rotations import quat_apply, quat_error_magnitude

from mjlab_tracking.kinematics import Kinematics
from mjlab_tracking.motion import (
  Motion,
  MotionError,
  is_ours,
  load_arrays,
  motion_from_arrays,
  names_in,
  numbers_in,
  rate_of,
)

QuaternionOrder = Literal["wxyz", "xyzw"]
JointMap = Mapping[str, str | float]
"""For each joint of the robot the name of the column that holds it, or the number it is held at [rad or m]."""

SEVEN_KEYS = ("fps", "joint_pos", "joint_vel", "body_pos_w", "body_quat_w", "body_lin_vel_w", "body_ang_vel_w")
PLACED = 0.005
"""How far bodies may be from where forward kinematics puts them [m, rad] for an order of names to count as proven."""
UPRIGHT, TILTED = 0.9, 0.8
"""Mean height of the root's z axis, of 1, above which a reading is upright, and below which it clearly is not."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Statement:
  """What the user says about a file; None where the file says it or its numbers prove it."""

  rate: float | None = None
  """Frames per second [Hz]."""
  quaternion: QuaternionOrder | None = None
  """Order of quaternions in the file."""
  joint_names: Sequence[str] | None = None
  """Names of the joint columns, in order."""
  body_names: Sequence[str] | None = None
  """Names of the bodies of a seven-key `.npz`, in order."""
  joint_map: JointMap | None = None
  """How the file's joints become the robot's; None: names are the same."""


def read_motion(path: str | os.PathLike[str], robot: Kinematics, said: Statement | None = None) -> Motion:
  """Read a clip and place it on a robot.

  Args:
    path: `.csv` (root position, root quaternion, joints), or `.npz`: a motion file of ours, the seven keys of
      BeyondMimic and mjlab, arrays with `joint_names`, or a MuJoCo rollout with `qpos`.
    robot: Whose motion it is.
    said: What the file does not say.

  Raises:
    MotionError: The file cannot be read, something is neither stated nor provable, or it does not fit the robot.
  """
  said = said or Statement()
  path = Path(path)
  if not path.is_file():
    raise MotionError(f"{path}: no such file")
  if path.suffix == ".csv":
    motion = _from_csv(path, robot, said)
  elif path.suffix == ".npz":
    motion = _from_npz(path, robot, said)
  else:
    raise MotionError(f"{path}: this reads .csv and .npz; convert other files without pickles to one of them")
  robot.columns_of(motion)
  return motion


def _from_npz(path: Path, robot: Kinematics, said: Statement) -> Motion:
  arrays = load_arrays(path)
  if is_ours(arrays):
    motion = motion_from_arrays(arrays, path)
    if said.rate is not None and said.rate != motion.rate:
      raise MotionError(f"{path}: it says {motion.rate:g} Hz, you say {said.rate:g}")
    if said.quaternion == "xyzw":
      raise MotionError(f"{path}: it says that w comes first, you say xyzw")
    motion = _mapped(motion, robot, said)
    if "body_pos_w" in arrays and said.joint_map is None:
      _check_bodies(path, arrays, motion, robot)
    return motion
  if "qpos" in arrays:
    qpos = numbers_in(arrays, "qpos", path, ndim=2)
    return _from_table(path, qpos, robot, said, _rate(path, arrays, said, len(qpos)), is_mujoco=True)
  named = _named(path, arrays, said)
  joints = len(robot.joint_names if named.joint_names is None else named.joint_names)
  if "joint_pos" in arrays:
    joint_pos = numbers_in(arrays, "joint_pos", path, ndim=2)
    # Some files have the root in front of the joints; it then needs no bodies.
    if "body_pos_w" not in arrays or joint_pos.shape[1] == 7 + joints:
      return _from_table(path, joint_pos, robot, named, _rate(path, arrays, said, len(joint_pos)))
  if missing := [name for name in ("joint_pos", "body_pos_w", "body_quat_w") if name not in arrays]:
    raise MotionError(f"{path}: lacks {', '.join(missing)}, it has: {', '.join(arrays) or 'nothing'}")
  return _from_seven_keys(path, arrays, robot, named, _rate(path, arrays, said, len(arrays["joint_pos"])))


def _named(path: Path, arrays: dict[str, np.ndarray], said: Statement) -> Statement:
  """The statement, completed by names that are in the file."""
  found = {
    kind: names_in(arrays, kind, path)
    for kind in ("joint_names", "body_names")
    if kind in arrays and getattr(said, kind) is None
  }
  return dataclasses.replace(said, **found)


def _rate(path: Path, arrays: dict[str, np.ndarray], said: Statement, frames: int) -> float:
  found = None
  if "fps" in arrays:
    found = rate_of(arrays, path)
  elif "times" in arrays:
    times = numbers_in({"times": arrays["times"].reshape(-1)}, "times", path, ndim=1)
    if len(times) != frames:
      raise MotionError(f"{path}: {len(times)} times for {frames} frames")
    steps = np.diff(times)
    if frames > 1 and not (steps.min() > 0.0 and np.ptp(steps) <= 1e-3 * steps.mean()):
      raise MotionError(f"{path}: its times are not evenly spaced: steps of {steps.min():.4g} to {steps.max():.4g} s")
    found = float(1.0 / steps.mean()) if frames > 1 else None
  stated = said.rate
  if found is None:
    if stated is None:
      raise MotionError(f"{path}: it does not say its rate; state it with --rate")
    return stated
  if stated is not None and abs(found - stated) > 1e-3 * found:
    raise MotionError(f"{path}: it says {found:g} Hz, you say {stated:g}")
  return found


# CSV


def _from_csv(path: Path, robot: Kinematics, said: Statement) -> Motion:
  try:
    lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
  except UnicodeDecodeError as error:
    raise MotionError(f"{path}: not a text ({error})") from error
  # A header may be commented out; other comments say nothing about columns.
  while lines and lines[0].lstrip().startswith("#") and "," not in lines[0]:
    del lines[0]
  header = [cell.strip().strip('"') for cell in lines[0].lstrip("# ").split(",")] if lines else []
  has_header = not all(_is_number(cell) for cell in header)
  if len(lines) <= has_header:
    raise MotionError(f"{path}: there are no numbers in it")
  try:
    table = np.loadtxt(lines[int(has_header) :], delimiter=",", ndmin=2)
  except ValueError as error:
    raise MotionError(f"{path}: not a table of numbers ({error})") from error
  if has_header and len(header) != table.shape[1]:
    raise MotionError(f"{path}: its header names {len(header)} columns, and there are {table.shape[1]}")
  names = said.joint_names
  if names is None and has_header:
    names = header[7:]
  if said.rate is None:
    raise MotionError(f"{path}: a CSV does not say its rate; state it with --rate")
  return _from_table(path, table, robot, dataclasses.replace(said, joint_names=names), said.rate)


def _is_number(cell: str) -> bool:
  try:
    float(cell)
  except ValueError:
    return False
  return True


# Root and joints in one table


def _from_table(
  path: Path, table: np.ndarray, robot: Kinematics, said: Statement, rate: float, is_mujoco: bool = False
) -> Motion:
  """Columns root position, quaternion in the order stated or proven, joints."""
  if table.shape[1] < 8:
    raise MotionError(f"{path}: {table.shape[1]} columns; expected root position, quaternion and joints")
  table = table.copy()
  if said.quaternion is not None:
    order, how = said.quaternion, "stated"
  elif is_mujoco:
    heights = _heights(table[:, 3:7])
    if heights["xyzw"] >= UPRIGHT and heights["wxyz"] <= TILTED:
      raise MotionError(
        f"{path}: a qpos has w first, but only as xyzw it is upright; state it with --quaternion wxyz or xyzw"
      )
    order, how = "wxyz", "those of MuJoCo"
  else:
    order, how = _proven_order(path, table[:, 3:7]), "proven: only so it is upright"
  if order == "xyzw":
    table[:, 3:7] = np.roll(table[:, 3:7], 1, 1)
  return _from_qpos(path, table, robot, said, rate).changed(f"quaternions {order} ({how})")


def _proven_order(path: Path, quaternions: np.ndarray) -> QuaternionOrder:
  """The order in which the root is upright, if in the other one it clearly is not.

  The two readings of a row are as far apart from one another in every frame, so speeds of rotation prove nothing.
  """
  heights = _heights(quaternions)
  wrong, right = sorted(heights, key=lambda order: heights[order])
  if heights[right] < UPRIGHT or heights[wrong] > TILTED:
    readings = ", ".join(f"{order} {height:+.2f}" for order, height in heights.items())
    raise MotionError(
      f"{path}: the order of its quaternions cannot be proven (mean height of the root's z axis: {readings}); state it "
      "with --quaternion wxyz or xyzw"
    )
  return right


def _heights(quaternions: np.ndarray) -> dict[QuaternionOrder, float]:
  """Mean height of the root's z axis in either reading of (frames, 4) numbers."""
  up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
  heights: dict[QuaternionOrder, float] = {}
  shifts: dict[QuaternionOrder, int] = {"wxyz": 0, "xyzw": 1}
  for order, shift in shifts.items():
    quat = torch.from_numpy(quaternions).roll(shift, 1)
    quat = quat / torch.linalg.vector_norm(quat, dim=-1, keepdim=True)
    heights[order] = float(quat_apply(quat, up)[:, 2].mean())
  return heights


def _from_qpos(path: Path, qpos: np.ndarray, robot: Kinematics, said: Statement, rate: float) -> Motion:
  """Columns root position, quaternion (w, x, y, z), joints."""
  names = tuple(said.joint_names) if said.joint_names is not None else robot.joint_names
  if qpos.shape[1] != 7 + len(names):
    whose = "names were given" if said.joint_names is not None else "joints has the robot"
    raise MotionError(
      f"{path}: {qpos.shape[1]} columns, expected 7 of the root and {len(names)} of joints (so many {whose}); state "
      "their names with --joint-names, and how they become the robot's with --joint-map"
    )
  table = torch.from_numpy(qpos)
  motion = Motion(
    name=path.stem,
    rate=rate,
    root_body=robot.root_body,
    joint_names=names,
    root_pos=table[:, :3],
    root_quat=table[:, 3:7],
    joint_pos=table[:, 7:],
    history=(f"read from {path.name}, {rate:g} Hz",),
  )
  return _mapped(motion, robot, said)


def _mapped(motion: Motion, robot: Kinematics, said: Statement) -> Motion:
  if said.joint_map is None:
    return motion
  columns: list[torch.Tensor] = []
  for joint, source in said.joint_map.items():
    if joint not in robot.joint_names:
      raise MotionError(unknown("joint", joint, robot.joint_names, owner="joint map: robot"))
    if isinstance(source, str) and source not in motion.joint_names:
      raise MotionError(unknown("column", source, motion.joint_names, owner=f"joint map: motion '{motion.name}'"))
  for joint in robot.joint_names:
    source = said.joint_map.get(joint, joint)
    if isinstance(source, str):
      if source not in motion.joint_names:
        raise MotionError(
          unknown("column", source, motion.joint_names, owner=f"motion '{motion.name}': joint '{joint}'")
        )
      columns.append(motion.joint_pos[:, motion.joint_names.index(source)])
    else:
      columns.append(torch.full((motion.num_frames,), float(source), dtype=torch.float64))
  return motion.changed(
    "joints renamed", joint_names=robot.joint_names, joint_pos=torch.stack(columns, 1), root_body=robot.root_body
  )


# Seven keys


def _from_seven_keys(
  path: Path, arrays: dict[str, np.ndarray], robot: Kinematics, said: Statement, rate: float
) -> Motion:
  """Joints and bodies in the order stated, or in the one that forward kinematics proves."""
  joint_pos = torch.from_numpy(numbers_in(arrays, "joint_pos", path, ndim=2))
  frames = joint_pos.shape[0]
  body_pos, body_quat = _body_poses(path, arrays, frames)
  if said.quaternion == "xyzw":
    body_quat = body_quat.roll(1, -1)
  if said.body_names is not None:
    _check_body_names(path, said.body_names, body_pos.shape[1], robot)
    unseen = [body for body in robot.ends if body not in said.body_names]
    if unseen and not said.joint_names:
      raise MotionError(
        f"{path}: its bodies do not prove the order of the joints on the way to '{unseen[0]}', which is not among "
        "them; state the order with --joint-names"
      )
    roots = [list(said.body_names).index(robot.root_body)]
  else:
    roots = list(range(body_pos.shape[1]))
  orders = {"as stated": tuple(said.joint_names)} if said.joint_names else _joint_orders(robot)
  best, reason = float("inf"), ""
  for how, names in orders.items():
    if len(names) != joint_pos.shape[1]:
      raise MotionError(f"{path}: {joint_pos.shape[1]} joint columns, {len(names)} names ({how})")
    for root in roots:
      motion = Motion(
        name=path.stem,
        rate=rate,
        root_body=robot.root_body,
        joint_names=names,
        root_pos=body_pos[:, root],
        root_quat=body_quat[:, root],
        joint_pos=joint_pos,
        history=(f"read from {path.name}, {rate:g} Hz",),
      )
      motion = _mapped(motion, robot, said)
      few = torch.linspace(0, frames - 1, min(frames, 8)).long()
      error, body = _misplacement(motion, robot, body_pos, body_quat, said.body_names, few)
      if error <= PLACED:
        error, body = _misplacement(motion, robot, body_pos, body_quat, said.body_names)
      if error <= PLACED:
        note = f"orders of joints ({how}) and bodies agree with forward kinematics within {error * 1e3:.2g} mm"
        return motion.changed(note)
      if error < best:
        best, reason = error, f"joints {how}, root in row {root}, body '{body}' is off by {error:.3g} m or rad"
  raise MotionError(
    f"{path}: it cannot be placed on this robot: no order of joints and bodies agrees with forward kinematics. "
    f"Nearest: {reason}. State the orders with --joint-names and --body-names, or xyzw with --quaternion; or it is "
    "another robot's."
  )


def _joint_orders(robot: Kinematics) -> dict[str, tuple[str, ...]]:
  """Depth first, as MuJoCo numbers joints, and breadth first, as PhysX does."""
  model = robot.model
  depth = {0: 0}
  for body in range(1, model.nbody):
    depth[body] = depth[int(model.body_parentid[body])] + 1
  by_level = sorted(range(len(robot.joint_ids)), key=lambda i: depth[int(model.jnt_bodyid[robot.joint_ids[i]])])
  return {"depth first": robot.joint_names, "breadth first": tuple(robot.joint_names[i] for i in by_level)}


def _misplacement(
  motion: Motion,
  robot: Kinematics,
  body_pos: torch.Tensor,
  body_quat: torch.Tensor,
  body_names: Sequence[str] | None,
  frames: torch.Tensor | slice = slice(None),
) -> tuple[float, str]:
  """How far the worst body is from forward kinematics, [m or rad] over `frames`, and its name.

  Without names, a body of the robot is the row that is nearest to it throughout.
  """
  body_pos, body_quat = body_pos[frames], body_quat[frames]
  pos, quat = robot.poses(motion.root_pos[frames], motion.root_quat[frames], robot.columns_of(motion)[frames])
  worst, name = 0.0, robot.root_body
  for row, body in enumerate(robot.body_names):
    if body_names is not None:
      if body not in body_names:
        continue
      candidates = [list(body_names).index(body)]
    else:
      candidates = list(range(body_pos.shape[1]))
    distance = torch.linalg.vector_norm(body_pos[:, candidates] - pos[:, row, None], dim=-1).amax(0)
    angle = quat_error_magnitude(body_quat[:, candidates], quat[:, row, None]).amax(0)
    error = float(torch.maximum(distance, angle).min())
    if error > worst:
      worst, name = error, body
  return worst, name


def _body_poses(path: Path, arrays: dict[str, np.ndarray], frames: int) -> tuple[torch.Tensor, torch.Tensor]:
  """Positions (frames, bodies, 3) and orientations (frames, bodies, 4) that a file has of bodies."""
  if "body_quat_w" not in arrays:
    raise MotionError(f"{path}: lacks body_quat_w, it has: {', '.join(arrays)}")
  body_pos, body_quat = (numbers_in(arrays, name, path, ndim=3) for name in ("body_pos_w", "body_quat_w"))
  if body_pos.shape[::2] != (frames, 3) or body_quat.shape != (*body_pos.shape[:2], 4):
    raise MotionError(f"{path}: shapes {body_pos.shape} and {body_quat.shape} of bodies do not fit {frames} frames")
  return torch.from_numpy(body_pos), torch.from_numpy(body_quat)


def _check_body_names(path: Path, names: Sequence[str], bodies: int, robot: Kinematics) -> None:
  if len(names) != bodies:
    raise MotionError(f"{path}: {len(names)} names for {bodies} bodies")
  if len(set(names)) < bodies:
    raise MotionError(f"{path}: a body is named twice")
  if robot.root_body not in names:
    raise MotionError(unknown("body", robot.root_body, names, owner=f"{path}: the names of its bodies"))


def _check_bodies(path: Path, arrays: dict[str, np.ndarray], motion: Motion, robot: Kinematics) -> None:
  names = names_in(arrays, "body_names", path) if "body_names" in arrays else ()
  body_pos, body_quat = _body_poses(path, arrays, motion.num_frames)
  _check_body_names(path, names, body_pos.shape[1], robot)
  error, body = _misplacement(motion, robot, body_pos, body_quat, names)
  if error > PLACED:
    raise MotionError(
      f"{path}: its body '{body}' is {error:.3g} m or rad from where this robot has it: it was made for another model"
    )
