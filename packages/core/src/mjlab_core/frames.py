"""Poses and velocities between frames. A pose is a position (..., 3) [m] and a unit quaternion (..., 4), (w, x, y, z).

`pos_ab, quat_ab` is the pose of frame b in frame a: it takes coordinates in b to coordinates in a.
"""

from __future__ import annotations

import torch
from torch import Tensor

from mjlab_core.rotations import cross, quat_apply, quat_apply_inverse, quat_conjugate, quat_mul


def transform_points(points: Tensor, pos: Tensor, quat: Tensor) -> Tensor:
  """Points (..., P, 3) of a frame in its parent's coordinates, (..., P, 3) [m]; `pos` (..., 3), `quat` (..., 4)."""
  return pos.unsqueeze(-2) + quat_apply(quat.unsqueeze(-2), points)


def combine_frames(pos_ab: Tensor, quat_ab: Tensor, pos_bc: Tensor, quat_bc: Tensor) -> tuple[Tensor, Tensor]:
  """Pose of c in a from the poses of b in a and of c in b: position (..., 3) and quaternion (..., 4)."""
  return pos_ab + quat_apply(quat_ab, pos_bc), quat_mul(quat_ab, quat_bc)


def subtract_frames(pos_wa: Tensor, quat_wa: Tensor, pos_wb: Tensor, quat_wb: Tensor) -> tuple[Tensor, Tensor]:
  """Pose of b in a from the poses of both in a third frame: position (..., 3) and quaternion (..., 4)."""
  return quat_apply_inverse(quat_wa, pos_wb - pos_wa), quat_mul(quat_conjugate(quat_wa), quat_wb)


def velocity_at(linear: Tensor, angular: Tensor, offset: Tensor) -> Tensor:
  """Linear velocity of the rigid body's point at `offset` from the point that moves with `linear`, (..., 3) [m/s].

  All three (..., 3) in one frame: `linear` [m/s], `angular` [rad/s], `offset` [m].
  """
  return linear + cross(angular, offset)


def heading(quat: Tensor) -> Tensor:
  """Yaw of the rotated x axis seen from above, (...) [rad]."""
  w, x, y, z = quat.unbind(-1)
  return torch.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
