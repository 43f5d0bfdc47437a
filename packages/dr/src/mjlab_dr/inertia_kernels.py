"""`perturb_inertia` as one Warp kernel, for GPUs where Warp is installed; torch launches hundreds."""

import functools
import math
from typing import Any

import torch
import warp as wp
from torch import Tensor


@wp.func
def diagonalize(matrix: wp.mat33d, sweeps: int):
  """Run `mjlab_dr.inertia.diagonalize` on one matrix."""
  m = wp.mat33d(matrix)
  turn = wp.quat_identity(dtype=wp.float64)
  one = wp.float64(1.0)
  half = wp.float64(0.5)
  for _sweep in range(sweeps):
    for back in range(3):
      axis = 2 - back
      i = (axis + 1) % 3
      j = (axis + 2) % 3
      gap = m[i, i] - m[j, j]
      twice = m[i, j] + m[i, j]
      length = wp.sqrt(gap * gap + twice * twice)
      reach = gap + wp.where(gap < wp.float64(0.0), -length, length)
      tangent = wp.float64(0.0)
      if reach != wp.float64(0.0):
        tangent = twice / reach
      cosine = one / wp.sqrt(tangent * tangent + one)
      sine = tangent * cosine
      # Cosine and sine of half the angle.
      c = wp.sqrt(half + half * cosine)
      rotation = wp.quatd(wp.float64(0.0), wp.float64(0.0), wp.float64(0.0), c)
      rotation[axis] = half * sine / c
      turn = turn * rotation
      r = wp.identity(n=3, dtype=wp.float64)
      r[i, i] = cosine
      r[j, j] = cosine
      r[i, j] = -sine
      r[j, i] = sine
      m = wp.transpose(r) * m * r
  return wp.get_diag(m), turn


@wp.func
def vector(x: wp.array3d[Any], i: int, j: int, first: int):
  """Return three numbers of a row in float64."""
  return wp.vec3d(wp.float64(x[i, j, first]), wp.float64(x[i, j, first + 1]), wp.float64(x[i, j, first + 2]))


@functools.cache
def kernel(real: type) -> wp.Kernel:
  """Return the kernel for wp.float32 or wp.float64, in separate modules: loading one does not unload the other."""

  @wp.kernel(enable_backward=False, module="unique")
  def perturb_inertia(
    sweeps: int,
    mass: wp.array2d[real],
    com: wp.array3d[real],
    inertia: wp.array3d[real],
    quat: wp.array3d[real],
    parameters: wp.array3d[real],
    mass_out: wp.array2d[real],
    com_out: wp.array3d[real],
    inertia_out: wp.array3d[real],
    quat_out: wp.array3d[real],
  ):
    """Run `mjlab_dr.inertia.perturb_inertia`, one body per thread."""
    i, j = wp.tid()
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    nothing = wp.vec3d()
    gain = wp.exp(two * wp.float64(parameters[i, j, 0]))
    d = vector(parameters, i, j, 1)
    s = vector(parameters, i, j, 4)
    change = wp.diag(wp.vec3d(wp.exp(d[0]) - one, wp.exp(d[1]) - one, wp.exp(d[2]) - one))
    change[0, 1] = s[0]
    change[0, 2] = s[1]
    change[1, 2] = s[2]
    c = vector(com, i, j, 0)
    moved = c + change * c + vector(parameters, i, j, 7)

    unit = wp.identity(n=3, dtype=wp.float64)
    w = wp.float64(quat[i, j, 0])
    v = vector(quat, i, j, 1)
    cross = wp.skew(v)
    # As `matrix_from_quat`, also where rounding to float32 has changed the length.
    axes = unit + two * (w * cross + cross * cross)
    given = vector(inertia, i, j, 0)
    half_trace = (given[0] + given[1] + given[2]) / two
    second = wp.max(wp.vec3d(half_trace, half_trace, half_trace) - given, nothing)
    local = unit + wp.transpose(axes) * change * axes
    moments, turn = diagonalize(local * wp.diag(second) * wp.transpose(local), sweeps)
    moments = gain * wp.max(moments, nothing)
    trace = moments[0] + moments[1] + moments[2]
    result = wp.vec3d(trace, trace, trace) - moments
    is_scaled = d == nothing and s == nothing
    if is_scaled:
      result = gain * given

    turned = wp.quatd(v[0], v[1], v[2], w) * turn
    mass_out[i, j] = real(gain * wp.float64(mass[i, j]))
    quat_out[i, j, 0] = real(turned[3])
    for k in range(3):
      com_out[i, j, k] = real(moved[k])
      inertia_out[i, j, k] = real(result[k])
      quat_out[i, j, 1 + k] = real(turned[k])
    if wp.static(real == wp.float32) and not (is_scaled and gain == one):
      # As in `rounded_moments`.
      stored = vector(inertia_out, i, j, 0)
      for k in range(3):
        others = stored[(k + 1) % 3] + stored[(k + 2) % 3]
        limit = real(others)
        if wp.float64(limit) > others:
          limit = real(wp.float64(limit) * wp.float64(wp.static(1.0 - 2.0**-24)))
        inertia_out[i, j, k] = wp.min(inertia_out[i, j, k], limit)

  return perturb_inertia


def launch(
  batch: torch.Size,
  mass: Tensor,
  com: Tensor,
  inertia: Tensor,
  quat: Tensor,
  parameters: Tensor,
  *,
  sweeps: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
  """Launch it on torch's current stream: tensors of one type, float32 or float64, that broadcast to `batch`."""
  wp.init()
  grid = (math.prod(batch[:-1]), math.prod(batch[-1:]))
  tails = ((), (3,), (3,), (4,), (10,))
  # Views: values that worlds share stay in memory once.
  given = [
    x.expand((*batch, *tail)).reshape(*grid, *tail)
    for x, tail in zip((mass, com, inertia, quat, parameters), tails, strict=True)
  ]
  results = [x.new_empty(x.shape) for x in given[:4]]
  # A recorded stream is already Warp's current stream.
  is_own = mass.is_cuda and not torch.cuda.is_current_stream_capturing()
  wp.launch(
    kernel(wp.dtype_from_torch(mass.dtype)),
    dim=grid,
    inputs=[sweeps, *map(wp.from_torch, given)],
    outputs=[*map(wp.from_torch, results)],
    device=wp.device_from_torch(mass.device),
    stream=wp.stream_from_torch(torch.cuda.current_stream(mass.device)) if is_own else None,
  )
  mass, com, inertia, quat = (x.view((*batch, *tail)) for x, tail in zip(results, tails, strict=False))
  return mass, com, inertia, quat
