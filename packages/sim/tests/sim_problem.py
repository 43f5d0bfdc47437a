"""States of a model with MuJoCo C's view of a constrained acceleration there."""

from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np

ROWS = 96


class Problem:
  """One state of a model, which `mj_forward` has solved.

  Args:
    model: the model.
    host: its data, after `mj_forward`.
    rows: room for constraint rows.
  """

  def __init__(self, model: mujoco.MjModel, host: mujoco.MjData, rows: int = ROWS) -> None:
    self.model, self.host = model, host
    self.best = host.qacc.copy()
    self.m = mjw.put_model(model)
    self.d: Any = mjw.put_data(model, host, nworld=1, nconmax=rows // 4, njmax=rows)
    self.d.qacc_warmstart.zero_()
    mjw.step1(self.m, self.d)
    mjw.fwd_actuation(self.m, self.d)
    mjw.fwd_acceleration(self.m, self.d)

  def judge(self, qacc: np.ndarray) -> tuple[float, float]:
    """Return the cost above that of MuJoCo C, in the unit of the tolerance, and the relative residual force."""
    cost, residual = self._cost(qacc.astype(float))
    size = np.linalg.norm(self.host.qfrc_constraint)
    inertia = np.zeros((self.model.nv, self.model.nv))
    mujoco.mj_fullM(self.model, self.host, inertia)
    return (cost - self._cost(self.best)[0]) / np.trace(inertia), float(np.linalg.norm(residual) / size)

  def _cost(self, qacc: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the cost of an acceleration, and the force that is missing for equilibrium."""
    model, host = self.model, self.host
    rows, force, cost = np.zeros(host.nefc), np.zeros(model.nv), np.zeros(1)
    mujoco.mj_mulJacVec(model, host, rows, qacc)
    mujoco.mj_constraintUpdate(model, host, rows - host.efc_aref, cost, 0)
    mujoco.mj_mulM(model, host, force, qacc - host.qacc_smooth)
    return cost[0] + 0.5 * (qacc - host.qacc_smooth) @ force, force - host.qfrc_constraint
