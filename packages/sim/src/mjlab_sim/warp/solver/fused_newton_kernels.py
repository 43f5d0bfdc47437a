"""Kernels of `FusedNewton`. `newton_world.cu` has the method; here it gets its sizes and its arguments."""

from pathlib import Path
from typing import Any

import mujoco_warp as mjw
import warp as wp

from mjlab_sim.warp.structs import with_arrays

_SOURCE = (Path(__file__).parent / "newton_world.cu").read_text(encoding="utf-8")


@with_arrays(
  """njmax iterations ls_iterations is_sparse tolerance ls_tolerance impratio_invsqrt M_rownnz M_rowadr M_colind ne nf
  nefc M qfrc_smooth contact_friction contact_dim contact_efc_address efc_type efc_id efc_J efc_J_rownnz efc_J_rowadr
  efc_J_colind efc_D efc_aref efc_frictionloss qacc qfrc_constraint efc_Ma efc_force efc_state solver_niter overflow"""
)
class Problem:
  """Arrays that a solve reads and writes."""

  start: wp.array2d[float]
  without_rows: wp.array2d[float]
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
    "NR": rows,
    "NZ": groups,
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
