"""Clips with body poses: forward kinematics proves the order of joints and bodies."""

from collections.abc import Sequence

import torch
from mjlab_core.errors import FileError
from mjlab_core.io.npz import Npz
from mjlab_core.names import check_name
from mjlab_core.rotations import quat_error_magnitude

from mjlab_motions.kinematics import Kinematics
from mjlab_motions.motion import Motion
from mjlab_motions.reading.statement import Statement, mapped

PLACED = 0.005
"""Largest distance of a body from forward kinematics [m, rad] for an order of names to count as proven."""


def from_seven_keys(archive: Npz, joint_pos: torch.Tensor, robot: Kinematics, said: Statement, rate: float) -> Motion:
  """Return the clip of the arrays of BeyondMimic and mjlab, in the stated order or in the one that kinematics proves.

  Args:
    archive: The file.
    joint_pos: Its joint positions, (frames, joints) [rad or m].
    robot: Robot of the clip.
    said: Facts stated by the user or by the file.
    rate: Frames per second [Hz].

  Raises:
    FileError: Arrays are missing or do not fit one another, or no order places the clip on the robot.
  """
  body_pos, body_quat = _body_poses(archive, joint_pos.shape[0])
  if said.quaternion == "xyzw":
    body_quat = body_quat.roll(1, -1)
  few = torch.linspace(0, joint_pos.shape[0] - 1, min(joint_pos.shape[0], 8)).long()
  best, reason = float("inf"), ""
  for order, names in _joint_orders(robot, said).items():
    for root in _possible_roots(robot, said, body_pos.shape[1]):
      motion = Motion(
        name=archive.path.stem,
        rate=rate,
        root_body=robot.root_body,
        joint_names=names,
        root_pos=body_pos[:, root],
        root_quat=body_quat[:, root],
        joint_pos=joint_pos,
        history=(f"read from {archive.path.name}, {rate:g} Hz",),
      )
      motion = mapped(motion, robot, said)
      for frames in (few, slice(None)):
        error, body = _misplacement(motion, robot, body_pos, body_quat, said.body_names, frames)
        # Not a number counts as misplaced.
        if not error <= PLACED:
          break
      else:
        note = f"orders of joints ({order}) and bodies agree with forward kinematics within {error * 1e3:.2g} mm"
        return motion.changed(note)
      if error < best:
        best, reason = error, f"joints {order}, root in row {root}, body '{body}' is off by {error:.3g} m or rad"
  remedy = "state the orders with --joint-names and --body-names, or xyzw with --quaternion, if it is of this robot"
  raise FileError(f"no order of joints and bodies agrees with forward kinematics. Nearest: {reason}; {remedy}")


def check_bodies(archive: Npz, motion: Motion, robot: Kinematics) -> None:
  """Compare the body poses of a motion file with forward kinematics.

  Raises:
    FileError: A body is elsewhere, so the file was made for another model.
  """
  names = archive.words("body_names")
  body_pos, body_quat = _body_poses(archive, motion.num_frames)
  _check_body_names(names, body_pos.shape[1], robot)
  error, body = _misplacement(motion, robot, body_pos, body_quat, names)
  if error > PLACED:
    raise FileError(f"its body '{body}' is {error:.3g} m or rad from where this robot has it; it is of another model")


def _possible_roots(robot: Kinematics, said: Statement, bodies: int) -> list[int]:
  """Return the rows of the body arrays that may hold the root."""
  if said.body_names is None:
    return list(range(bodies))
  _check_body_names(said.body_names, bodies, robot)
  unseen = [body for body in robot.ends if body not in said.body_names]
  if unseen and not said.joint_names:
    raise FileError(f"without body '{unseen[0]}' the order of joints is not proven; state it with --joint-names")
  return [list(said.body_names).index(robot.root_body)]


def _joint_orders(robot: Kinematics, said: Statement) -> dict[str, tuple[str, ...]]:
  """Return the names of the joint columns: as stated, or depth first, as in MuJoCo, and breadth first, as in PhysX."""
  model = robot.model
  depth = {0: 0}
  for body in range(1, model.nbody):
    depth[body] = depth[int(model.body_parentid[body])] + 1
  by_level = sorted(range(len(robot.joint_ids)), key=lambda i: depth[int(model.jnt_bodyid[robot.joint_ids[i]])])
  orders = {"depth first": robot.joint_names, "breadth first": tuple(robot.joint_names[i] for i in by_level)}
  if said.joint_names:
    orders = {"as stated": tuple(said.joint_names)}
  return orders


def _misplacement(
  motion: Motion,
  robot: Kinematics,
  body_pos: torch.Tensor,
  body_quat: torch.Tensor,
  body_names: Sequence[str] | None,
  frames: torch.Tensor | slice = slice(None),
) -> tuple[float, str]:
  """Return the largest distance of a body from forward kinematics over `frames` [m or rad], and the body's name.

  Without names, a body of the robot is the row that is nearest to it throughout.
  """
  body_pos, body_quat = body_pos[frames], body_quat[frames]
  pos, quat = robot.poses(motion.root_pos[frames], motion.root_quat[frames], robot.columns_of(motion)[frames])
  worst, name = 0.0, robot.root_body
  for row, body in enumerate(robot.body_names):
    if body_names is None:
      candidates = list(range(body_pos.shape[1]))
    elif body in body_names:
      candidates = [list(body_names).index(body)]
    else:
      continue
    distance = torch.linalg.vector_norm(body_pos[:, candidates] - pos[:, row, None], dim=-1).amax(0)
    angle = quat_error_magnitude(body_quat[:, candidates], quat[:, row, None]).amax(0)
    error = float(torch.maximum(distance, angle).min())
    # Not a number counts as misplaced.
    if not error <= worst:
      worst, name = error, body
  return worst, name


def _body_poses(archive: Npz, frames: int) -> tuple[torch.Tensor, torch.Tensor]:
  """Return positions (frames, bodies, 3) and orientations (frames, bodies, 4) of the bodies in a file."""
  body_pos, body_quat = (archive.numbers(name, ndim=3) for name in ("body_pos_w", "body_quat_w"))
  if body_pos.shape[::2] != (frames, 3) or body_quat.shape != (*body_pos.shape[:2], 4):
    raise FileError(f"shapes {body_pos.shape} and {body_quat.shape} of bodies do not fit {frames} frames")
  return torch.from_numpy(body_pos), torch.from_numpy(body_quat)


def _check_body_names(names: Sequence[str], bodies: int, robot: Kinematics) -> None:
  if not len(names) == len(set(names)) == bodies:
    raise FileError(f"{len(names)} names, {len(set(names))} different ones, for {bodies} bodies")
  check_name("body", robot.root_body, names, "the names of its bodies")
