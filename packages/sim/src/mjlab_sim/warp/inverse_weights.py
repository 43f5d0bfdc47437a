"""Inverse weights at the reference pose: the constants of MuJoCo that follow from the inertia matrix.

MuJoCo scales constraints by the diagonal of A = J inv(M) J' at qpos0. MuJoCo Warp solves for one row of J after the
other, each for all worlds: hundreds of launches for a humanoid. Here M is factored and the factor inverted, which
fills nothing in: R of inv(M) = R R' has an entry for each dof and its ancestors, as M has. Then A = (J R) (J R)' is a
short sum for each row by itself, and worlds outside the mask cost nothing.
"""

import dataclasses

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from mjlab_sim.warp import internals
from mjlab_sim.warp import inverse_weight_kernels as kernels

_BLOCK = 32
"""Threads that share a world's factorisation: one warp."""


class InverseWeights:
  """Memory and launches for `dof_invweight0`, `body_invweight0`, `tendon_invweight0` and `actuator_acc0`.

  Args:
    model: What is simulated.
    m: The same in MuJoCo Warp.
    d: Its data; its device is where all of this runs.
  """

  def __init__(self, model: mujoco.MjModel, m: mjw.Model, d: mjw.Data) -> None:
    self._m, self._d = m, d
    self._longest = int(model.M_rownnz.max(initial=0))
    pairs = np.stack(np.tril_indices(self._longest), axis=1)
    # float32, because numpy multiplies no matrices of integers fast.
    is_entry = np.zeros((model.nv, model.nv), dtype=np.float32)
    is_entry[np.repeat(np.arange(model.nv), model.M_rownnz), model.M_colind] = 1.0
    with wp.ScopedDevice(d.qpos.device):
      # Bodies that only slide along their parent's axes; MuJoCo gives them their inverse mass, armature or not.
      self._is_slider = wp.array(model.body_simple == 2, dtype=wp.bool)
      self._pairs = wp.array(pairs, dtype=wp.vec2i)
      self._above = wp.array(model.M_rowadr[model.M_colind], dtype=int)
      self._num_shared = wp.array((is_entry @ is_entry.T).astype(np.int32), dtype=int)
      self._root = wp.empty_like(d.M)
      self._qpos0 = wp.empty_like(d.qpos)
      self._no_contacts = wp.zeros_like(d.nacon)

  def compute(self, mask: wp.array) -> None:
    """Derive the constants of the worlds in `mask`, shape (nworld,); `d` must hold the kinematics at qpos0.

    Fields that all worlds share are those of world 0. `d.M` and what belongs to actuators are not left as the state
    has them.
    """
    self._invert(mask)
    m, d = self._m, self._d
    rows, sliders = [m.M_rowadr, self._root], [self._is_slider, m.body_mass]
    shared = [m.M_rowadr, self._num_shared, self._root]
    joints = [m.dof_jntid, m.jnt_type, m.jnt_dofadr, m.dof_bodyid]
    entries = [m.M_rownnz, m.M_colind]
    tree = [m.body_parentid, m.body_rootid, m.body_dofadr, m.body_dofnum, m.dof_parentid]
    motion = [d.subtree_com, d.xipos, d.cdof]
    tendons = [m.ten_J_rownnz, m.ten_J_rowadr, m.ten_J_colind, d.ten_J]
    moments = [d.moment_rownnz, d.moment_rowadr, d.moment_colind, d.actuator_moment]
    for kernel, field, inputs in (
      (kernels.weigh_dofs, m.dof_invweight0, [*shared, *joints, *sliders]),
      (kernels.weigh_bodies, m.body_invweight0, [*rows, *entries, *sliders, *tree, *motion]),
      (kernels.weigh_tendons, m.tendon_invweight0, [*shared, *tendons]),
      (kernels.accelerate, m.actuator_acc0, [*shared, *moments]),
    ):
      wp.launch(kernel, dim=field.shape, inputs=[mask, *inputs], outputs=[field])

  def _invert(self, mask: wp.array) -> None:
    """Find R of inv(M) = R R' at qpos0, and the moments of the actuators there."""
    m, d = self._m, self._d
    mjw.crb(m, d)
    internals.tendon_armature(m, d)
    self._transmit()
    wp.launch_tiled(
      kernels.invert_inertia,
      dim=d.nworld,
      inputs=[mask, m.M_rownnz, m.M_rowadr, self._above, self._pairs, self._longest],
      outputs=[d.M, self._root],
      block_dim=_BLOCK,
    )

  def _transmit(self) -> None:
    """Moments of the actuators at qpos0, without the contacts that adhesion averages over, as in MuJoCo."""
    m, d = self._m, self._d
    wp.launch(kernels.rest, dim=d.qpos.shape, inputs=[m.qpos0], outputs=[self._qpos0])
    mjw.transmission(m, dataclasses.replace(d, qpos=self._qpos0, nacon=self._no_contacts))
