"""Inverse weights at the reference pose: the constants of MuJoCo that follow from the inertia matrix.

MuJoCo scales constraints by the diagonal of A = J inv(M) J' at qpos0. MuJoCo Warp solves for one row of J after the
other, each for all worlds: hundreds of launches for a humanoid. Here M is factored and the factor inverted, which
fills nothing in: R of inv(M) = R R' has an entry for each dof and its ancestors, as M has. Then A = (J R) (J R)' is a
short sum for each row by itself, and worlds outside the mask cost nothing.
"""

import dataclasses
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from mjlab_sim.warp import internals
from mjlab_sim.warp.constants import inverse_weight_kernels as kernels
from mjlab_sim.warp.structs import filled

_BLOCK = 32
"""Threads that share a world's factorisation: one warp."""


class InverseWeights:
  """Memory and launches for `dof_invweight0`, `body_invweight0`, `tendon_invweight0` and `actuator_acc0`.

  Args:
    model: The compiled model.
    m: The same in MuJoCo Warp.
    d: Its data, on the device of the computation.
  """

  def __init__(self, model: mujoco.MjModel, m: mjw.Model, d: mjw.Data) -> None:
    self._m, self._d = m, d
    longest = int(model.M_rownnz.max(initial=0))
    pairs = np.stack(np.tril_indices(longest), axis=1)
    # float32, because numpy multiplies no matrices of integers fast.
    is_entry = np.zeros((model.nv, model.nv), dtype=np.float32)
    is_entry[np.repeat(np.arange(model.nv), model.M_rownnz), model.M_colind] = 1.0
    with wp.ScopedDevice(d.qpos.device):
      self._own = {
        "is_slider": wp.array(model.body_simple == 2, dtype=wp.bool),
        "pairs": wp.array(pairs, dtype=wp.vec2i),
        "longest": longest,
        "above": wp.array(model.M_rowadr[model.M_colind], dtype=int),
        "num_shared": wp.array((is_entry @ is_entry.T).astype(np.int32), dtype=int),
        "root": wp.empty_like(d.M),
      }
      self._no_contacts = wp.zeros_like(d.nacon)

  def compute(self, mask: wp.array) -> None:
    """Derive the constants of the worlds in `mask`, shape (nworld,); `d` must hold the kinematics at qpos0.

    Fields that all worlds share are those of world 0. `d.M` and fields of actuators are overwritten.
    """
    m, d = self._m, self._d
    mjw.crb(m, d)
    internals.tendon_armature(m, d)
    # Moments of the actuators at qpos0, without the contacts that adhesion averages over, as in MuJoCo.
    qpos0: Any = wp.to_torch(m.qpos0).expand(d.qpos.shape)
    mjw.transmission(m, dataclasses.replace(d, qpos=wp.from_torch(qpos0), nacon=self._no_contacts))
    worlds = filled(kernels.Worlds, m, d, mask=mask, **self._own)
    wp.launch_tiled(kernels.invert_inertia, dim=d.nworld, inputs=[worlds], block_dim=_BLOCK)
    for kernel, field in (
      (kernels.weigh_dofs, m.dof_invweight0),
      (kernels.weigh_bodies, m.body_invweight0),
      (kernels.weigh_tendons, m.tendon_invweight0),
      (kernels.accelerate, m.actuator_acc0),
    ):
      wp.launch(kernel, dim=field.shape, inputs=[worlds])
