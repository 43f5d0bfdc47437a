"""Perturbation of inertial parameters that stays physical whatever is drawn.

After Rucker and Wensing, "Smooth parameterization of rigid-body inertia", IEEE RA-L 7(2), 2022. A body of mass m,
centre of mass c and second moments S about it (S = tr(I)/2 - I) is physically consistent if and only if its
pseudo-inertia J = [[S + m c c^T, m c], [m c^T, m]] is positive definite. With the upper triangular

  U = e^alpha [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]]

J' = U J U^T is so again, for any ten real numbers (alpha, d1, d2, d3, s12, s13, s23, t1, t2, t3): mass and inertia are
scaled by e^(2 alpha), space is stretched by d and sheared by s about the origin of the body frame, and moved by t.
With A, the upper left of U / e^alpha, that is m' = e^(2 alpha) m, c' = A c + t, S' = e^(2 alpha) A S A^T, which needs
no factorisation, loses nothing for light bodies far from the origin, and holds for planar and rod-like bodies too.
"""

from __future__ import annotations

from importlib.util import find_spec

import torch
from mjlab_core import matrix_from_quat, normalize, quat_mul
from torch import Tensor

# Convergence is quadratic; random matrices are at rounding after four.
_SWEEPS = 4


def perturb_inertia(
  mass: Tensor, com: Tensor, inertia: Tensor, quat: Tensor, parameters: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
  """Return the inertial parameters after J' = U J U^T, exactly those given where all parameters are zero.

  Computed in float64, without a host sync; float32 on a GPU is one launch where Warp is installed. Principal axes turn
  as little as they can: nothing is reordered for small perturbations, and equal moments are no special case. A body
  without mass keeps none. Batch dimensions broadcast. Gradients are finite where no two moments are equal.

  Args:
    mass: (...) [kg].
    com: centre of mass in the body frame, (..., 3) [m].
    inertia: principal moments, (..., 3) [kg m^2].
    quat: principal axes in the body frame, (..., 4).
    parameters: alpha, d1, d2, d3, s12, s13, s23 [1], t1, t2, t3 [m], (..., 10).

  Returns:
    The same four, in float32 if all is given in it and else in float64. Moments are at least zero, and none is above
    the sum of the other two.
  """
  given = (mass, com, inertia, quat, parameters)
  dtype = torch.float32 if all(x.dtype == torch.float32 for x in given) else torch.float64
  batch = torch.broadcast_shapes(mass.shape, *(x.shape[:-1] for x in given[1:]))
  # The kernel has no gradients.
  has_gradients = torch.is_grad_enabled() and any(x.requires_grad for x in given)
  if _has_kernel(mass.device) and dtype == torch.float32 and 0 not in batch and not has_gradients:
    from mjlab_dr.inertia_kernels import launch

    return launch(batch, *given, sweeps=_SWEEPS)
  mass, com, inertia, quat, p = (x.double() for x in given)
  p = p.expand(*batch, 10)
  gain = (2.0 * p[..., 0]).exp()
  # A - 1, so that a perturbation of nothing is nothing.
  change = torch.diag_embed(torch.expm1(p[..., 1:4]))
  change[..., 0, 1:], change[..., 1, 2] = p[..., 4:6], p[..., 6]
  moved = com + (change @ com.unsqueeze(-1)).squeeze(-1) + p[..., 7:]

  axes = matrix_from_quat(quat)
  second = (0.5 * inertia.sum(-1, keepdim=True) - inertia).clamp_min(0.0)
  # In the principal frame of before, where the second moments are diagonal.
  local = torch.eye(3, dtype=p.dtype, device=p.device) + axes.mT @ change @ axes
  moments, turn = diagonalize((local * second.unsqueeze(-2)) @ local.mT)
  moments = moments.clamp_min(0.0) * gain.unsqueeze(-1)
  result = moments.sum(-1, keepdim=True) - moments
  if dtype == torch.float32:
    result = rounded_moments(result)
  # Moments of inertia from second moments and back again lose the last bit.
  is_same = (p[..., :7] == 0.0).all(-1, keepdim=True)
  result = torch.where(is_same, inertia.to(dtype), result)
  return (mass * gain).to(dtype), moved.to(dtype), result, quat_mul(quat.expand(turn.shape), turn).to(dtype)


def inertia_perturbation(
  mass: Tensor,
  com: Tensor,
  inertia: Tensor,
  quat: Tensor,
  to_mass: Tensor,
  to_com: Tensor,
  to_inertia: Tensor,
  to_quat: Tensor,
) -> Tensor:
  """Return the ten parameters that turn the first four inertial parameters into the last four, (..., 10), in float64.

  The inverse of `perturb_inertia`. NaN unless both have mass and volume: a planar body has several answers.
  """
  before, after = second_moments(inertia, quat), second_moments(to_inertia, to_quat)
  ratio = to_mass.double() / mass.double()
  # A S A^T = S' / e^(2 alpha), with upper triangular factors on both sides.
  a = torch.linalg.solve_triangular(
    _upper_factor(before), _upper_factor(after / ratio[..., None, None]), upper=True, left=False
  )
  moved = to_com.double() - (a @ com.double().unsqueeze(-1)).squeeze(-1)
  stretch, shear = a.diagonal(dim1=-2, dim2=-1).log(), torch.cat((a[..., 0, 1:], a[..., 1, 2:]), -1)
  return torch.cat((0.5 * ratio.log().unsqueeze(-1), stretch, shear, moved), -1)


def _has_kernel(device: torch.device) -> bool:
  # Not on a CPU, where it gains little, and the first call would wait for Warp to start and to compile.
  return device.type == "cuda" and find_spec("warp") is not None


def rounded_moments(inertia: Tensor) -> Tensor:
  """Return moments in float32, (..., 3), of which none is above the sum of the other two either."""
  rounded = inertia.float()
  # Rounding may lift one above by half a unit in its last place. Sums of two are exact in float64.
  others = rounded.sum(-1, dtype=torch.float64, keepdim=True) - rounded
  limit = others.float()
  return rounded.minimum(torch.where(limit > others, limit.nextafter(torch.zeros_like(limit)), limit))


def second_moments(inertia: Tensor, quat: Tensor) -> Tensor:
  """Return tr(I)/2 - I about the centre of mass in the body frame, (..., 3, 3)."""
  inertia, axes = inertia.double(), matrix_from_quat(quat.double())
  return (axes * (0.5 * inertia.sum(-1, keepdim=True) - inertia).unsqueeze(-2)) @ axes.mT


def _upper_factor(matrix: Tensor) -> Tensor:
  """Return the upper triangular F with F F^T = `matrix`; NaN unless that is positive definite beyond rounding."""
  factor, info = torch.linalg.cholesky_ex(matrix.flip(-1, -2))
  pivots = factor.diagonal(dim1=-2, dim2=-1)
  is_solid = (info == 0) & (pivots.amin(-1) > 1e-7 * pivots.amax(-1))
  return torch.where(is_solid[..., None, None], factor, torch.nan).flip(-1, -2)


def diagonalize(matrix: Tensor) -> tuple[Tensor, Tensor]:
  """Return the eigenvalues (..., 3) of symmetric matrices, and the rotation to their eigenvectors, (..., 4).

  Cyclic Jacobi: `torch.linalg.eigh` waits for the device, and reorders eigenvalues that should stay in place.
  """
  d = list(matrix.diagonal(dim1=-2, dim2=-1).unbind(-1))
  # Each entry beside the diagonal has the index of the axis that it does not belong to.
  off = [matrix[..., 1, 2], matrix[..., 0, 2], matrix[..., 0, 1]]
  zero = torch.zeros_like(off[0])
  w, v = zero + 1.0, [zero, zero, zero]
  for _ in range(_SWEEPS):
    for k in (2, 1, 0):
      i, j = (k + 1) % 3, (k + 2) % 3
      # Tangent of the angle about axis k that zeroes the entry ij, at most 45 degrees; two zeros need no rotation.
      gap, twice = d[i] - d[j], 2.0 * off[k]
      tangent = (twice / (torch.hypot(gap, twice).copysign(gap) + gap)).nan_to_num(nan=0.0)
      cosine = (tangent.square() + 1.0).rsqrt()
      sine = tangent * cosine
      moved = tangent * off[k]
      d[i], d[j] = d[i] + moved, d[j] - moved
      off[i], off[j], off[k] = cosine * off[i] - sine * off[j], cosine * off[j] + sine * off[i], zero
      # Tangent of half the angle; the quaternion gets its length back at the end.
      half = sine / (cosine + 1.0)
      w, v[k] = w - half * v[k], v[k] + half * w
      v[i], v[j] = v[i] + half * v[j], v[j] - half * v[i]
  return torch.stack(d, -1), normalize(torch.stack((w, *v), -1))
