"""Rotations as unit quaternions (w, x, y, z), and frames: pure functions over any leading shape.

All functions broadcast their leading dimensions, keep dtype and device, and run without a host sync, so they may be
recorded in a CUDA graph. Quaternions must be unit; `normalize` scales them. A quaternion and its negative are the same
rotation, and every function that returns an angle or a rotation vector treats them alike.

A pose is a position (..., 3) [m] and a quaternion (..., 4). `pos_ab, quat_ab` is the pose of frame b in frame a: it
takes coordinates in b to coordinates in a.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor


def normalize(x: Tensor, eps: float = 1e-9) -> Tensor:
  """Scale `x` to unit length along its last dimension, (..., n); vectors shorter than `eps` shrink towards zero."""
  return x / torch.linalg.vector_norm(x, dim=-1, keepdim=True).clamp_min(eps)


def cross(a: Tensor, b: Tensor) -> Tensor:
  """Return the cross product, (..., 3); unlike torch's own it broadcasts over any number of leading dimensions."""
  if a.dim() != b.dim():
    a, b = torch.broadcast_tensors(a, b)
  return torch.linalg.cross(a, b)


def wrap_to_pi(angle: Tensor) -> Tensor:
  """Return the same angle in [-pi, pi], (...) [rad]; angles already inside come back bit-identical."""
  return angle - torch.round(angle / (2.0 * math.pi)) * (2.0 * math.pi)


def quat_mul(a: Tensor, b: Tensor) -> Tensor:
  """Return the Hamilton product, (..., 4): the rotation `b` followed by the rotation `a`."""
  aw, av = a[..., :1], a[..., 1:]
  bw, bv = b[..., :1], b[..., 1:]
  w = aw * bw - (av * bv).sum(-1, keepdim=True)
  v = aw * bv + bw * av + cross(av, bv)
  return torch.cat((w, v), dim=-1)


def quat_conjugate(q: Tensor) -> Tensor:
  """Return (w, -x, -y, -z), (..., 4); for unit quaternions the inverse rotation."""
  return torch.cat((q[..., :1], -q[..., 1:]), dim=-1)


def quat_apply(q: Tensor, v: Tensor) -> Tensor:
  """Rotate `v` by `q`, (..., 3): takes coordinates in the rotated frame to coordinates in the parent frame."""
  axis = q[..., 1:]
  t = 2.0 * cross(axis, v)
  return v + q[..., :1] * t + cross(axis, t)


def quat_apply_inverse(q: Tensor, v: Tensor) -> Tensor:
  """Rotate `v` by the inverse of `q`, (..., 3): takes coordinates in the parent frame to the rotated frame."""
  axis = q[..., 1:]
  t = 2.0 * cross(axis, v)
  return v - q[..., :1] * t + cross(axis, t)


def quat_unique(q: Tensor) -> Tensor:
  """Return the representative with w >= 0, (..., 4)."""
  return torch.where(q[..., :1] < 0.0, -q, q)


def quat_from_euler_xyz(roll: Tensor, pitch: Tensor, yaw: Tensor) -> Tensor:
  """Return the quaternion of Rz(yaw) Ry(pitch) Rx(roll), (..., 4); angles (...) [rad] about the fixed axes x, y, z."""
  half = 0.5 * torch.stack(torch.broadcast_tensors(roll, pitch, yaw), dim=-1)
  (cr, cp, cy), (sr, sp, sy) = half.cos().unbind(-1), half.sin().unbind(-1)
  cpcy, spsy, cpsy, spcy = cp * cy, sp * sy, cp * sy, sp * cy
  return torch.stack(
    (cr * cpcy + sr * spsy, sr * cpcy - cr * spsy, cr * spcy + sr * cpsy, cr * cpsy - sr * spcy), dim=-1
  )


def euler_xyz_from_quat(q: Tensor) -> tuple[Tensor, Tensor, Tensor]:
  """Return roll, pitch and yaw, each (...) [rad], of Rz(yaw) Ry(pitch) Rx(roll).

  Pitch is in [-pi/2, pi/2], the others in [-pi, pi]. In gimbal lock roll and yaw are not unique; the returned triple
  still gives the rotation back. After Bernardes and Viollet, "Quaternion to Euler angles conversion: a direct, general
  and computationally efficient method" (2022).
  """
  w, x, y, z = q.unbind(-1)
  a, b, c, d = w - y, x + z, w + y, z - x
  half_sum, half_difference = torch.atan2(b, a), torch.atan2(d, c)
  pitch = 2.0 * torch.atan2(torch.hypot(c, d), torch.hypot(a, b)) - 0.5 * math.pi
  return wrap_to_pi(half_sum - half_difference), pitch, wrap_to_pi(half_sum + half_difference)


def quat_from_rotvec(rotvec: Tensor) -> Tensor:
  """Return the exponential map, (..., 4): rotation about `rotvec`, (..., 3), by its length [rad]."""
  angle = torch.linalg.vector_norm(rotvec, dim=-1, keepdim=True)
  # sinc keeps sin(angle / 2) / angle exact through zero without a branch.
  return torch.cat((torch.cos(0.5 * angle), 0.5 * torch.sinc(angle / (2.0 * math.pi)) * rotvec), dim=-1)


def rotvec_from_quat(q: Tensor) -> Tensor:
  """Return the logarithmic map, (..., 3) [rad]: a rotation vector of length at most pi; `q` and `-q` give the same."""
  q = quat_unique(q)
  w, v = q[..., :1], q[..., 1:]
  s = torch.linalg.vector_norm(v, dim=-1, keepdim=True)
  small = s < 1e-12
  scale = 2.0 * torch.atan2(s, w) / torch.where(small, 1.0, s)
  return torch.where(small, 2.0, scale) * v


def matrix_from_quat(q: Tensor) -> Tensor:
  """Return the rotation matrix, (..., 3, 3); its columns are the rotated axes in the parent frame."""
  axes = torch.eye(3, dtype=q.dtype, device=q.device)
  return quat_apply(q.unsqueeze(-2), axes).mT.contiguous()


def quat_from_matrix(matrix: Tensor) -> Tensor:
  """Return the quaternion with w >= 0 of rotation matrices (..., 3, 3), (..., 4); accurate for every angle.

  The four rows below are 4 q_i q; the one with the largest q_i is free of cancellation (Shepperd, 1978).
  """
  m00, m01, m02, m10, m11, m12, m20, m21, m22 = matrix.flatten(-2).unbind(-1)
  wx, wy, wz = m21 - m12, m02 - m20, m10 - m01
  xy, xz, yz = m10 + m01, m02 + m20, m21 + m12
  ww, xx = 1.0 + m00 + m11 + m22, 1.0 + m00 - m11 - m22
  yy, zz = 1.0 - m00 + m11 - m22, 1.0 - m00 - m11 + m22
  rows = torch.stack((ww, wx, wy, wz, wx, xx, xy, xz, wy, xy, yy, yz, wz, xz, yz, zz), dim=-1).unflatten(-1, (4, 4))
  best = torch.stack((ww, xx, yy, zz), dim=-1).argmax(-1)
  row = rows.gather(-2, best[..., None, None].expand(*best.shape, 1, 4)).squeeze(-2)
  return quat_unique(normalize(row))


def quat_yaw(q: Tensor) -> Tensor:
  """Return the yaw of roll-pitch-yaw as a quaternion about z, (..., 4): the heading of the rotated x axis."""
  half = 0.5 * heading(q)
  zero = torch.zeros_like(half)
  return torch.stack((half.cos(), zero, zero, half.sin()), dim=-1)


def quat_box_minus(a: Tensor, b: Tensor) -> Tensor:
  """Return the shortest rotation vector from `b` to `a` in the parent (world) frame, (..., 3) [rad]."""
  return rotvec_from_quat(quat_mul(a, quat_conjugate(b)))


def quat_box_plus(q: Tensor, rotvec: Tensor) -> Tensor:
  """Turn `q` by a rotation vector in the parent (world) frame, (..., 4); undoes `quat_box_minus`."""
  return quat_mul(quat_from_rotvec(rotvec), q)


def quat_error_magnitude(a: Tensor, b: Tensor) -> Tensor:
  """Return the angle of the shortest rotation between `a` and `b`, (...) [rad], in [0, pi]."""
  relative = quat_mul(a, quat_conjugate(b))
  return 2.0 * torch.atan2(torch.linalg.vector_norm(relative[..., 1:], dim=-1), relative[..., 0].abs())


def quat_slerp(a: Tensor, b: Tensor, t: Tensor | float) -> Tensor:
  """Return the rotation at a share `t` of the shortest way from `a` to `b`, (..., 4); `t` is a number or (...)."""
  if isinstance(t, Tensor):
    t = t.unsqueeze(-1)
  return quat_box_plus(a, t * quat_box_minus(b, a))


def random_quat(
  shape: int | Sequence[int],
  *,
  generator: torch.Generator | None = None,
  device: torch.device | str | None = None,
  dtype: torch.dtype = torch.float32,
) -> Tensor:
  """Draw rotations uniformly from SO(3), (*shape, 4)."""
  shape = (shape,) if isinstance(shape, int) else tuple(shape)
  return normalize(torch.randn(*shape, 4, generator=generator, device=device, dtype=dtype))


def combine_frames(pos_ab: Tensor, quat_ab: Tensor, pos_bc: Tensor, quat_bc: Tensor) -> tuple[Tensor, Tensor]:
  """Return the pose of c in a from the poses of b in a and of c in b: position (..., 3) and quaternion (..., 4)."""
  return pos_ab + quat_apply(quat_ab, pos_bc), quat_mul(quat_ab, quat_bc)


def subtract_frames(pos_wa: Tensor, quat_wa: Tensor, pos_wb: Tensor, quat_wb: Tensor) -> tuple[Tensor, Tensor]:
  """Return the pose of b in a from the poses of both in a third frame: position (..., 3) and quaternion (..., 4)."""
  return quat_apply_inverse(quat_wa, pos_wb - pos_wa), quat_mul(quat_conjugate(quat_wa), quat_wb)


def heading(quat: Tensor) -> Tensor:
  """Return the yaw of the rotated x axis seen from above, (...) [rad]."""
  w, x, y, z = quat.unbind(-1)
  return torch.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
