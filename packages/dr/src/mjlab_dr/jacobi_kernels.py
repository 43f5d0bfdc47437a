"""Diagonalisation as one Warp kernel, for where Warp is installed: by torch it is four hundred."""

import torch
import warp as wp
from torch import Tensor


@wp.kernel(enable_backward=False, module="unique")
def jacobi(sweeps: int, matrix: wp.array[wp.mat33d], moments: wp.array[wp.vec3d], turn: wp.array[wp.vec4d]):
  """The rotations of `mjlab_dr.inertia.diagonalize`, one matrix a thread."""
  tid = wp.tid()
  m = matrix[tid]
  q = wp.vec4d(wp.float64(1.0), wp.float64(0.0), wp.float64(0.0), wp.float64(0.0))
  one = wp.float64(1.0)
  two = wp.float64(2.0)
  half = wp.float64(0.5)
  for _sweep in range(sweeps):
    for back in range(3):
      axis = 2 - back
      i = (axis + 1) % 3
      j = (axis + 2) % 3
      gap = m[i, i] - m[j, j]
      entry = m[i, j]
      length = wp.sqrt(gap * gap + two * two * entry * entry)
      reach = gap + wp.where(gap < wp.float64(0.0), -length, length)
      tangent = wp.float64(0.0)
      if reach != wp.float64(0.0):
        tangent = two * entry / reach
      cosine = one / wp.sqrt(tangent * tangent + one)
      sine = tangent * cosine
      m[i, i] = m[i, i] + tangent * entry
      m[j, j] = m[j, j] - tangent * entry
      # The entries of the axis' row, each a mixture of both.
      first = cosine * m[axis, i] + sine * m[axis, j]
      second = cosine * m[axis, j] - sine * m[axis, i]
      m[axis, i] = first
      m[i, axis] = first
      m[axis, j] = second
      m[j, axis] = second
      m[i, j] = wp.float64(0.0)
      m[j, i] = wp.float64(0.0)
      c = wp.sqrt(half + half * cosine)
      s = half * sine / c
      w = q[0]
      a = q[1 + axis]
      q[0] = w * c - a * s
      q[1 + axis] = a * c + w * s
      b = q[1 + i]
      d = q[1 + j]
      q[1 + i] = b * c + d * s
      q[1 + j] = d * c - b * s
  moments[tid] = wp.vec3d(m[0, 0], m[1, 1], m[2, 2])
  turn[tid] = q


def diagonalize(matrix: Tensor, sweeps: int) -> tuple[Tensor, Tensor]:
  """Eigenvalues and rotations of float64 matrices, (..., 3, 3), on torch's current stream."""
  wp.init()
  flat = matrix.reshape(-1, 3, 3).contiguous()
  moments, turn = flat.new_empty(len(flat), 3), flat.new_empty(len(flat), 4)
  # Who records a stream has made it Warp's too.
  is_own = flat.is_cuda and not torch.cuda.is_current_stream_capturing()
  wp.launch(
    jacobi,
    dim=len(flat),
    inputs=[sweeps, wp.from_torch(flat, dtype=wp.mat33d)],
    outputs=[wp.from_torch(moments, dtype=wp.vec3d), wp.from_torch(turn, dtype=wp.vec4d)],
    device=wp.device_from_torch(flat.device),
    stream=wp.stream_from_torch(torch.cuda.current_stream(flat.device)) if is_own else None,
  )
  return moments.view(*matrix.shape[:-2], 3), turn.view(*matrix.shape[:-2], 4)
