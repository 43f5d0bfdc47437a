"""Kernels of `FusedNewton`. `newton_world.cu` has the method; here it gets its sizes and its arguments."""

from pathlib import Path
from typing import Any

import mujoco_warp as mjw
import warp as wp

_SOURCE = (Path(__file__).parent / "newton_world.cu").read_text(encoding="utf-8")
_vec5: Any = wp.types.vector(length=5, dtype=float)


@wp.struct
class Problem:
  """Arrays that a solve reads and writes, named as in MuJoCo Warp's `Model` and `Data`."""

  # Model:
  njmax: int
  iterations: int
  ls_iterations: int
  is_sparse: int
  tolerance: wp.array[float]
  ls_tolerance: wp.array[float]
  impratio_invsqrt: wp.array[float]
  M_rownnz: wp.array[int]
  M_rowadr: wp.array[int]
  M_colind: wp.array[int]
  # Data in:
  ne: wp.array[int]
  nf: wp.array[int]
  nefc: wp.array[int]
  M: wp.array2d[float]
  qfrc_smooth: wp.array2d[float]
  start: wp.array2d[float]
  without_rows: wp.array2d[float]
  contact_friction: wp.array[_vec5]
  contact_dim: wp.array[int]
  contact_efc_address: wp.array2d[int]
  efc_type: wp.array2d[int]
  efc_id: wp.array2d[int]
  efc_J: wp.array3d[float]  # noqa: N815
  J_rownnz: wp.array2d[int]
  J_rowadr: wp.array2d[int]
  J_colind: wp.array3d[int]
  efc_D: wp.array2d[float]  # noqa: N815
  efc_aref: wp.array2d[float]
  efc_frictionloss: wp.array2d[float]
  # Data out:
  qacc: wp.array2d[float]
  qfrc_constraint: wp.array2d[float]
  efc_Ma: wp.array2d[float]  # noqa: N815
  efc_force: wp.array2d[float]
  efc_state: wp.array2d[int]
  solver_niter: wp.array[int]
  overflow: wp.array[int]
  # Between the two kernels:
  is_left: wp.array[bool]
  scratch: wp.array2d[float]


def make_kernel(
  nv: int, rows: int, groups: int, *, threads: int, is_elliptic: bool, in_memory: bool, registers: int | None = None
) -> Any:
  """Return the kernel that solves models of `nv` degrees of freedom.

  Args:
    nv: Degrees of freedom.
    rows: Constraint rows of a world that the kernel has room for.
    groups: Groups of four numbers of the Jacobian, likewise.
    threads: Threads of a block.
    is_elliptic: True if friction cones are elliptic.
    in_memory: Rows are in global memory, and worlds are those that another kernel left.
    registers: Upper bound of registers of a thread; None lets the compiler choose.
  """
  constants = {
    "NV": nv,
    "NR": max(rows, 1),
    "NZ": max(groups, 1),
    "NT": threads,
    "ELLIPTIC": int(is_elliptic),
    "IN_MEMORY": int(in_memory),
    "LIMIT_REACHED": int(mjw.OverflowType.ITERATIONS),
  }
  source = "".join(f"#define {name} {value}\n" for name, value in constants.items()) + _SOURCE

  @wp.func_native(source)
  def solve_world(given: Problem, w: int, block: int, lane: int): ...

  @wp.kernel(module="unique", enable_backward=False, grid_stride=False, cuda_max_registers=registers)
  def fused_newton(problem: Problem, nworld: int, blocks: int):
    block, lane = wp.tid()
    for w in range(block, nworld, blocks):
      solve_world(problem, w, block, lane)

  return fused_newton
