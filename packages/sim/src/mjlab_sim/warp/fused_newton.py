"""Newton's constraint solver of MuJoCo as one kernel: a block solves one world, all iterations inside.

MuJoCo Warp launches a dozen kernels per iteration until the last of all worlds is done. Here a world costs its own
iterations. `newton_world.cu` has the method; this module says which models it covers, and launches it.

Rows of the constraint Jacobian live in shared memory. A world with more of them than fit is left to a second kernel,
whose few blocks keep the Jacobian in global memory.
"""

from pathlib import Path
from typing import Any

import mujoco_warp as mjw
import warp as wp
from mjlab_core import MjlabError

from mjlab_sim.warp import internals

_SOURCE = (Path(__file__).parent / "newton_world.cu").read_text()
_MAX_DOFS = 64
_SHARED_BYTES = 48 * 1024
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
  efc_J: wp.array3d[float]
  J_rownnz: wp.array2d[int]
  J_rowadr: wp.array2d[int]
  J_colind: wp.array3d[int]
  efc_D: wp.array2d[float]
  efc_aref: wp.array2d[float]
  efc_frictionloss: wp.array2d[float]
  # Data out:
  qacc: wp.array2d[float]
  qfrc_constraint: wp.array2d[float]
  efc_Ma: wp.array2d[float]
  efc_force: wp.array2d[float]
  efc_state: wp.array2d[int]
  solver_niter: wp.array[int]
  overflow: wp.array[int]
  # Between the two kernels:
  is_left: wp.array[bool]
  scratch: wp.array2d[float]


def refusal(m: mjw.Model, d: mjw.Data) -> str | None:
  """Return the reason why the fused solver does not cover this model, None if it does."""
  reasons = {
    f"this MuJoCo Warp is {mjw.__version__}, it was tested with {internals.TESTED}": not internals.IS_TESTED,
    "its solver is not Newton": m.opt.solver != mjw.SolverType.NEWTON,
    "bodies may sleep, in islands": bool(m.opt.enableflags & mjw.EnableBit.SLEEP),
    "its integrator is discrete": m.opt.integrator == mjw.IntegratorType.DISCRETE,
    "it has a flex": m.nflex > 0,
    "it asks for noslip iterations": m.opt.noslip_iterations > 0,
    "it allows no solver iterations": m.opt.iterations < 1 or m.opt.ls_iterations < 1,
    "it has no degrees of freedom": m.nv == 0,
    f"it has {m.nv} degrees of freedom, more than {_MAX_DOFS}": m.nv > _MAX_DOFS,
    f"njmax {d.njmax} does not fit shared memory": _bytes(m.nv, d.njmax, 0, 256) > _SHARED_BYTES,
    "its buffers hold no constraint rows": d.njmax == 0,
  }
  return next((reason for reason, applies in reasons.items() if applies), None)


def choose_solver(m: mjw.Model, d: mjw.Data, backend: str) -> "FusedNewton | None":
  """Return the solver that `SimulationCfg.solver_backend` asks for; None stands for MuJoCo Warp's own.

  Raises:
    MjlabError: the fused solver was asked for and does not cover the model.
  """
  if backend == "mujoco_warp":
    return None
  reason = refusal(m, d)
  if backend == "fused" and reason is not None:
    raise MjlabError(f"solver_backend 'fused' does not cover this model: {reason}. Set it to 'auto' or 'mujoco_warp'.")
  # With one thread, as on a CPU, it is the slower of the two.
  return FusedNewton(m, d) if reason is None and (backend == "fused" or d.qacc.device.is_cuda) else None


def _bytes(nv: int, rows: int, groups: int, threads: int) -> int:
  """Shared memory of one block."""
  padded = 4 * -(-nv // 4)
  return 4 * (nv * padded + 8 * padded + 8 + 8 * -(-threads // 32) + 8 * rows + 4 * groups + 8)


class FusedNewton:
  """Solver of one model's constraints.

  Args:
    m: Model that `refusal` has nothing against.
    d: Data; its sizes are fixed.
    threads: Threads of a block, a multiple of 32.
    rows: Constraint rows that shared memory holds for a world.
    groups: Groups of four numbers of the Jacobian that shared memory holds for a world.
  """

  def __init__(self, m: mjw.Model, d: mjw.Data, *, threads: int = 32, rows: int = 96, groups: int = 384) -> None:
    device = d.qacc.device
    self._threads = threads if device.is_cuda else 1
    most = d.njmax * -(-m.nv // 4)
    rows, groups = min(rows, d.njmax), min(groups, most)
    shared = {"threads": self._threads, "is_elliptic": m.opt.cone == mjw.ConeType.ELLIPTIC}
    self._kernel = _make_kernel(m.nv, rows, groups, in_memory=False, **shared)
    self._full = None
    self._is_left = wp.zeros(d.nworld, dtype=bool, device=device)
    self._blocks = min(d.nworld, 2 * getattr(device, "sm_count", 0) or 1)
    if rows < d.njmax or groups < most:
      self._full = _make_kernel(m.nv, d.njmax, most, in_memory=True, **shared)
    self._scratch = wp.zeros((self._blocks if self._full else 1, 4 * most + 4), dtype=float, device=device)

  def solve(self, m: mjw.Model, d: mjw.Data) -> None:
    """Find the constraint forces and the acceleration of every world, as `mujoco_warp.solve` does."""
    problem = self._problem(m, d)
    self._launch(self._kernel, d.nworld, problem, d)
    if self._full is not None:
      self._launch(self._full, self._blocks, problem, d)

  def _launch(self, kernel: Any, blocks: int, problem: Any, d: mjw.Data) -> None:
    arguments = {"dim": (blocks, self._threads), "inputs": [problem, d.nworld, blocks], "device": d.qacc.device}
    if d.qacc.device.is_cuda:
      arguments["block_dim"] = self._threads
    wp.launch(kernel, **arguments)

  def _problem(self, m: mjw.Model, d: mjw.Data) -> Any:
    problem: Any = Problem()
    warm = not m.opt.disableflags & mjw.DisableBit.WARMSTART
    efc, contact = d.efc, d.contact
    for owner, prefix, names in (
      (m, "", "M_rownnz M_rowadr M_colind"),
      (m.opt, "", "iterations ls_iterations tolerance ls_tolerance impratio_invsqrt"),
      (d, "", "njmax ne nf nefc M qfrc_smooth qacc qfrc_constraint solver_niter overflow"),
      (contact, "contact_", "friction dim efc_address"),
      (efc, "efc_", "type id J D aref frictionloss Ma force state"),
      (efc, "", "J_rownnz J_rowadr J_colind"),
    ):
      for name in names.split():
        setattr(problem, prefix + name, getattr(owner, name))
    problem.is_sparse = int(m.is_sparse)
    problem.start = d.qacc_warmstart if warm else d.qacc_smooth
    # Without rows the smooth acceleration is the answer, where it is computed.
    problem.without_rows = d.qacc_smooth if m.opt.run_qacc_smooth or not warm else d.qacc_warmstart
    problem.is_left, problem.scratch = self._is_left, self._scratch
    return problem


def _make_kernel(nv: int, rows: int, groups: int, *, threads: int, is_elliptic: bool, in_memory: bool) -> Any:
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

  @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
  def fused_newton(problem: Problem, nworld: int, blocks: int):
    block, lane = wp.tid()
    for w in range(block, nworld, blocks):
      solve_world(problem, w, block, lane)

  return fused_newton
