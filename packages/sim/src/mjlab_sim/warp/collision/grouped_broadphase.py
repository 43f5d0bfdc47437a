"""Broad phase for robots among many geoms that stay in place, such as boxes of a terrain.

MuJoCo Warp tests every pair of geoms in every world. Where the ground has hundreds of geoms, nearly no pair touches.
Here the geoms of a robot are put into small groups. Each geom that stays is tested against the boxes around groups, and
only where these meet, the pairs are tested, by MuJoCo Warp's own tests. The pairs found are the same. Poses are read in
every step, so a geom that stays may also be moved by writes.
"""

from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from mjlab_sim.warp import internals
from mjlab_sim.warp.collision import grouped_broadphase_kernels as kernels
from mjlab_sim.warp.structs import filled

_SAVED = 1000
"""Threads that groups have to save in a world; with fewer, the second kernel costs more."""
_NEEDED = int(mjw.BroadphaseFilter.SPHERE | mjw.BroadphaseFilter.OBB)
"""Tests of pairs that leave out all that is left out here."""


def grouped_broadphase(model: mujoco.MjModel, m: mjw.Model, d: mjw.Data) -> "GroupedBroadphase | None":
  """Return a broad phase for this model; None if MuJoCo Warp's own is as good or is required.

  It saves nothing without many pairs of one robot and geoms that stay, such as for loose objects, each of which is a
  separate group. It does not support sleeping bodies, nor tests of pairs other than MuJoCo Warp's default.
  """
  sleeps = bool(m.opt.enableflags & mjw.EnableBit.SLEEP)
  has_tests = m.opt.broadphase_filter & _NEEDED == _NEEDED
  if sleeps or not has_tests or not internals.IS_TESTED or m.opt.broadphase != mjw.BroadphaseType.NXN:
    return None
  found = GroupedBroadphase(model, m, d)
  return found if found.saved >= _SAVED else None


class GroupedBroadphase:
  """Pairs of a model in rows: a geom that stays and a group of geoms of one robot.

  Args:
    model: MuJoCo's model.
    m: Model.
    d: Data; its sizes may change.
    members: Geoms of a group at most: few are a tight box and short work, many are fewer groups.
  """

  def __init__(self, model: mujoco.MjModel, m: mjw.Model, d: mjw.Data, *, members: int = 16) -> None:
    geoms, pairid = m.nxn_geom_pair_filtered.numpy(), m.nxn_pairid_filtered.numpy()
    stays = model.body_dofnum[model.body_weldid[model.geom_bodyid]] == 0
    fixed = np.where(stays[geoms[:, 0]], geoms[:, 0], geoms[:, 1])
    moving = geoms.sum(1) - fixed
    # Explicit pairs have separate margins, and pairs of a distance sensor are always kept.
    in_rows = (stays[geoms].sum(1) == 1) & (pairid == -1).all(1)
    member = np.unique(moving[in_rows])
    tree = model.body_treeid[model.geom_bodyid[member]]
    member, tree = member[np.argsort(tree, kind="stable")], np.sort(tree)
    begins = (np.arange(len(member)) - np.searchsorted(tree, tree)) % members == 0
    group_of = np.full(model.ngeom, -1)
    group_of[member] = np.cumsum(begins) - 1
    # Other pairs are rows of one pair each, behind the rest.
    alone = np.where(in_rows, -1, np.arange(len(geoms)))
    keys = np.stack([alone, fixed, np.where(in_rows, group_of[moving], -1)], 1)
    keys, row, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(row.ravel(), kind="stable")
    rows = np.stack([keys[:, 1], keys[:, 2], np.cumsum(count) - count, count], 1)
    self.saved = len(geoms) - len(rows)
    """Threads per world that are fewer than pairs."""
    with wp.ScopedDevice(d.qpos.device):
      self._pairs = filled(
        kernels.Pairs,
        m,
        d,
        geoms=wp.array(geoms[order], dtype=wp.vec2i),
        pairid=wp.array(pairid[order], dtype=wp.vec2i),
        row=wp.array(rows.astype(np.int32), dtype=wp.vec4i),
        first=wp.array(np.append(np.flatnonzero(begins), len(member)).astype(np.int32), dtype=int),
        member=wp.array(member.astype(np.int32), dtype=int),
        center=wp.zeros((d.nworld, begins.sum()), dtype=wp.vec3),
        half=wp.zeros((d.nworld, begins.sum()), dtype=wp.vec3),
      )

  def find_pairs(self, m: mjw.Model, d: mjw.Data, found: Any, awake_before: Any = None) -> None:
    """List the pairs of geoms that may touch, as MuJoCo Warp's `nxn_broadphase` does.

    Args:
      m: Model.
      d: Data.
      found: Pairs, to be filled.
      awake_before: Not used, since no body sleeps.
    """
    geoms = filled(kernels.Geoms, m, d)
    wp.launch(kernels.bound_groups, dim=self._pairs.center.shape, inputs=[geoms, self._pairs])
    varying = (m.geom_aabb, m.geom_rbound, m.geom_margin, m.geom_gap, m.pair_margin, m.pair_gap)
    kernel = kernels.make_find_pairs(int(m.opt.broadphase_filter), *(array.shape[0] for array in varying))
    lists = d.ncollision, found.collision_pair, found.collision_pairid, found.collision_worldid
    dim = d.nworld, self._pairs.row.shape[0]
    wp.launch(kernel, dim=dim, inputs=[geoms, self._pairs, d.naconmax, *lists])
