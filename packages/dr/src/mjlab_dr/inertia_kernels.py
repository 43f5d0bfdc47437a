"""`perturb_inertia` for float32 as one Warp kernel, for GPUs where Warp is installed; torch launches hundreds."""

import math

import torch
import warp as wp
from torch import Tensor

wp.init()
vec10 = wp.types.vector(10, wp.float32)


@wp.func
def diagonalize(matrix: wp.mat33d, sweeps: int):
  """Run `mjlab_dr.inertia.diagonalize` on one matrix."""
  m = wp.mat33d(matrix)
  turn = wp.quat_identity(dtype=wp.float64)
  for _sweep in range(sweeps):
    for back in range(3):
      k = 2 - back
      i = (k + 1) % 3
      j = (k + 2) % 3
      if m[i, j] != wp.float64(0.0):
        axis = wp.vec3d()
        axis[k] = wp.float64(1.0)
        angle = wp.float64(0.5) * wp.atan(wp.float64(2.0) * m[i, j] / (m[i, i] - m[j, j]))
        rotation = wp.quat_from_axis_angle(axis, angle)
        axes = wp.quat_to_matrix(rotation)
        m = wp.transpose(axes) * m * axes
        turn = turn * rotation
  return wp.get_diag(m), turn


@wp.kernel(enable_backward=False)
def perturb_inertia(
  sweeps: int,
  mass: wp.array2d[wp.float32],
  com: wp.array2d[wp.vec3f],
  inertia: wp.array2d[wp.vec3f],
  quat: wp.array2d[wp.vec4f],
  parameters: wp.array2d[vec10],
  mass_out: wp.array2d[wp.float32],
  com_out: wp.array2d[wp.vec3f],
  inertia_out: wp.array2d[wp.vec3f],
  quat_out: wp.array2d[wp.vec4f],
):
  """Run `mjlab_dr.inertia.perturb_inertia`, one body per thread."""
  world, body = wp.tid()
  two = wp.float64(2.0)
  unit = wp.identity(n=3, dtype=wp.float64)
  p = wp.vector(parameters[world, body], dtype=wp.float64)
  gain = wp.exp(two * p[0])
  change = wp.diag(wp.vec3d(wp.exp(p[1]), wp.exp(p[2]), wp.exp(p[3]))) - unit
  change[0, 1] = p[4]
  change[0, 2] = p[5]
  change[1, 2] = p[6]
  centre = wp.vec3d(com[world, body])
  mass_out[world, body] = wp.float32(gain * wp.float64(mass[world, body]))
  com_out[world, body] = wp.vec3f(centre + change * centre + p[7:10])

  q = wp.vector(quat[world, body], dtype=wp.float64)
  cross = wp.skew(q[1:4])
  # As `matrix_from_quat`, also where rounding to float32 has changed the length.
  axes = unit + two * (q[0] * cross + cross * cross)
  given = wp.vec3d(inertia[world, body])
  half_trace = (given[0] + given[1] + given[2]) / two
  second = wp.max(wp.vec3d(half_trace, half_trace, half_trace) - given, wp.vec3d())
  local = unit + wp.transpose(axes) * change * axes
  moments, turn = diagonalize(local * wp.diag(second) * wp.transpose(local), sweeps)
  moments = gain * wp.max(moments, wp.vec3d())
  turned = wp.quatd(q[1], q[2], q[3], q[0]) * turn
  quat_out[world, body] = wp.vec4f(wp.vec4d(turned[3], turned[0], turned[1], turned[2]))

  trace = moments[0] + moments[1] + moments[2]
  stored = wp.vec3f(wp.vec3d(trace, trace, trace) - moments)
  result = wp.vec3f(stored)
  # As in `rounded_moments`.
  for k in range(3):
    others = wp.float64(stored[(k + 1) % 3]) + wp.float64(stored[(k + 2) % 3])
    limit = wp.float32(others)
    if wp.float64(limit) > others:
      limit = wp.float32(wp.float64(limit) * wp.float64(wp.static(1.0 - 2.0**-24)))
    result[k] = wp.min(result[k], limit)
  if wp.max(wp.abs(p[0:7])) == wp.float64(0.0):
    result = inertia[world, body]
  inertia_out[world, body] = result


def launch(batch: torch.Size, *given: Tensor, sweeps: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
  """Launch it on torch's current stream: the arguments of `perturb_inertia` in float32, which broadcast to `batch`."""
  grid = (math.prod(batch[:-1]), math.prod(batch[-1:]))
  tails = ((), (3,), (3,), (4,), (10,))
  # Views: values that worlds share stay in memory once.
  given = tuple(
    x.contiguous().expand((*batch, *tail)).reshape(*grid, *tail) for x, tail in zip(given, tails, strict=True)
  )
  results = [x.new_empty(x.shape) for x in given[:4]]
  dtypes = (wp.float32, wp.vec3f, wp.vec3f, wp.vec4f, vec10)
  inputs, outputs = (
    [wp.from_torch(x, dtype=dtype) for x, dtype in zip(tensors, dtypes, strict=False)] for tensors in (given, results)
  )
  device = given[0].device
  # A recorded stream is already Warp's current stream.
  is_own = device.type == "cuda" and not torch.cuda.is_current_stream_capturing()
  wp.launch(
    perturb_inertia,
    dim=grid,
    inputs=[sweeps, *inputs],
    outputs=outputs,
    device=wp.device_from_torch(device),
    stream=wp.stream_from_torch(torch.cuda.current_stream(device)) if is_own else None,
  )
  mass, com, inertia, quat = (x.view((*batch, *tail)) for x, tail in zip(results, tails, strict=False))
  return mass, com, inertia, quat
