"""What a unit force accelerates in the reference pose: the constants of MuJoCo that follow from the inertia matrix.

MuJoCo scales constraints by the diagonal of A = J inv(M) J' at qpos0. MuJoCo Warp solves for one row of J after the
other, each for all worlds: hundreds of launches for a humanoid. Here M = L' D L is factored and L inverted in place,
which fills nothing in: inv(L) has an entry for each dof and its ancestors, as M has. Then A = (J inv(L)) inv(D)
(J inv(L))' is a short sum for each row by itself, and worlds that nobody asked about cost nothing.
"""

import mujoco
import mujoco_warp as mjw
import warp as wp
from mujoco_warp._src import smooth

from mjlab_sim import inverse_weight_kernels as kernels


class InverseWeights:
  """Memory and launches for `dof_invweight0`, `body_invweight0`, `tendon_invweight0` and `actuator_acc0`.

  Args:
    model: What is simulated.
    m: The same in MuJoCo Warp.
    d: Its data; its device is where all of this runs.
  """

  def __init__(self, model: mujoco.MjModel, m: mjw.Model, d: mjw.Data) -> None:
    self._m, self._d = m, d
    with wp.ScopedDevice(d.qpos.device):
      # Bodies that only slide along their parent's axes; MuJoCo gives them their inverse mass, armature or not.
      self._is_slider = wp.array(model.body_simple == 2, dtype=wp.bool)
      self._inverse = wp.empty_like(d.M)
      self._scale = wp.empty((d.nworld, m.nv), dtype=float)
      self._qpos = wp.empty_like(d.qpos)
      self._nacon = wp.empty_like(d.nacon)

  def compute(self, mask: wp.array) -> None:
    """Derive the constants of the worlds in `mask`, shape (nworld,); `d` must hold the kinematics at qpos0.

    Fields that all worlds share are those of world 0.
    """
    m, d = self._m, self._d
    smooth.crb(m, d)
    smooth.tendon_armature(m, d)
    self._transmit()
    structure = [m.M_rownnz, m.M_rowadr, m.M_colind]
    wp.launch(
      kernels.invert_inertia, dim=d.nworld, inputs=[mask, *structure, d.M], outputs=[self._inverse, self._scale]
    )
    sliders = [self._is_slider, m.body_mass]
    factor = [*structure, self._inverse, self._scale]
    for kernel, field, inputs in (
      (kernels.weigh_dofs, m.dof_invweight0, [m.dof_jntid, m.jnt_type, m.jnt_dofadr, m.dof_bodyid, *sliders]),
      (
        kernels.weigh_bodies,
        m.body_invweight0,
        [
          *sliders,
          m.body_parentid,
          m.body_rootid,
          m.body_dofadr,
          m.body_dofnum,
          m.dof_parentid,
          d.subtree_com,
          d.xipos,
          d.cdof,
        ],
      ),
      (kernels.weigh_tendons, m.tendon_invweight0, [m.ten_J_rownnz, m.ten_J_rowadr, m.ten_J_colind, d.ten_J]),
      (kernels.accelerate, m.actuator_acc0, [d.moment_rownnz, d.moment_rowadr, d.moment_colind, d.actuator_moment]),
    ):
      wp.launch(kernel, dim=field.shape, inputs=[mask, *factor, *inputs], outputs=[field])

  def _transmit(self) -> None:
    """Moments of the actuators at qpos0, without the contacts that adhesion averages over, as in MuJoCo."""
    m, d = self._m, self._d
    wp.copy(self._qpos, d.qpos)
    wp.copy(self._nacon, d.nacon)
    wp.launch(kernels.rest, dim=d.qpos.shape, inputs=[m.qpos0], outputs=[d.qpos])
    d.nacon.zero_()
    smooth.transmission(m, d)
    wp.copy(d.qpos, self._qpos)
    wp.copy(d.nacon, self._nacon)
