"""Newton's constraint solver of MuJoCo as one kernel: a block solves one world, all iterations inside.

MuJoCo Warp launches a dozen kernels per iteration until the last of all worlds is done. Here a world costs its own
iterations. `newton_world.cu` has the method; this module says which models it covers, and launches it.

Rows of the constraint Jacobian live in shared memory. A world with more of them than fit is left to a second kernel,
whose few blocks keep their rows in global memory.
"""

from typing import Any

import mujoco_warp as mjw
import warp as wp
from mjlab_core import MjlabError

from mjlab_sim.warp import internals
from mjlab_sim.warp.solver.fused_newton_kernels import Problem, make_kernel
from mjlab_sim.warp.structs import filled

_MAX_DOFS = 64
_MAX_GROUPS = 2**16 - 1
_SMALL = 24
"""Degrees of freedom up to which blocks of one warp beat blocks of two."""


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
    f"njmax {d.njmax} is too large": d.njmax * _groups(m.nv) > _MAX_GROUPS,
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


def _groups(nv: int) -> int:
  """Return the number of groups of four columns."""
  return -(-nv // 4)


class FusedNewton:
  """Solver of one model's constraints.

  Where a size is None it is the best of those that `tools/benchmark_solver.py` measures.

  Args:
    m: Model that `refusal` has nothing against.
    d: Data; its sizes are fixed.
    threads: Threads of a block, a multiple of 32.
    rows: Constraint rows that shared memory holds for a world.
    groups: Groups of four numbers of the Jacobian that shared memory holds for a world.
    registers: Upper bound of registers of a thread; None lets the compiler choose.
  """

  def __init__(
    self,
    m: mjw.Model,
    d: mjw.Data,
    *,
    threads: int | None = None,
    rows: int | None = None,
    groups: int | None = None,
    registers: int | None = None,
  ) -> None:
    device: Any = d.qacc.device
    self._threads = (threads or (32 if m.nv <= _SMALL else 64)) if device.is_cuda else 1
    self._sizes = rows, groups, registers
    self._blocks = min(d.nworld, 2 * getattr(device, "sm_count", 0) or 1)
    self.is_left: Any = wp.zeros(d.nworld, dtype=bool, device=device)
    """True for worlds that the last solve left to the second kernel, (num_envs,)."""
    self._build(m, d)

  def _build(self, m: mjw.Model, d: mjw.Data) -> None:
    self._njmax, most = d.njmax, d.njmax * _groups(m.nv)
    rows, groups, registers = self._sizes
    # Little shared memory lets many blocks run at once; rows are a multiple of the threads that share them.
    usual = (96, 384) if m.nv <= _SMALL else (128, 768)
    rows, groups = min(rows or usual[0], d.njmax), min(groups or usual[1], most)
    shared: dict[str, Any] = {
      "threads": self._threads,
      "is_elliptic": m.opt.cone == mjw.ConeType.ELLIPTIC,
      "registers": registers,
    }
    self.kernels = [make_kernel(m.nv, rows, groups, in_memory=False, **shared)]
    """The kernel of all worlds, and the one of worlds that it leaves."""
    floats = 0
    if rows < d.njmax or groups < most:
      self.kernels.append(make_kernel(m.nv, d.njmax, most, in_memory=True, **shared))
      floats = 4 * most + 4 + 8 * -(-d.njmax // 4) * 4
    self._scratch = wp.zeros((self._blocks, floats), dtype=float, device=d.qacc.device)

  def solve(self, m: mjw.Model, d: mjw.Data) -> None:
    """Find the constraint forces and the acceleration of every world, as `mujoco_warp.solve` does."""
    if d.njmax != self._njmax:
      self._build(m, d)
    warm = not m.opt.disableflags & mjw.DisableBit.WARMSTART
    problem = filled(
      Problem,
      m,
      d,
      start=d.qacc_warmstart if warm else d.qacc_smooth,
      # Without rows the smooth acceleration is the answer, where it is computed.
      without_rows=d.qacc_smooth if m.opt.run_qacc_smooth or not warm else d.qacc_warmstart,
      is_left=self.is_left,
      scratch=self._scratch,
    )
    for kernel, blocks in zip(self.kernels, (d.nworld, self._blocks), strict=False):
      dim, inputs = (blocks, self._threads), [problem, d.nworld, blocks]
      wp.launch(kernel, dim=dim, inputs=inputs, block_dim=self._threads)
