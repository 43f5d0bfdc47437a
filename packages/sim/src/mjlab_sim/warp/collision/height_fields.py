"""Collisions with height fields, one thread per prism.

MuJoCo Warp gives a pair of geoms to one thread, which collides the geom with one prism of the height field after
another. Few threads have such a pair, and the busiest decide how long all take. Here the prisms under all geoms are
listed first, and then each is the work of one thread. The contacts are the same.
"""

import functools
from collections.abc import Sequence
from typing import Any

import mujoco_warp as mjw
import warp as wp

from mjlab_sim.warp import internals
from mjlab_sim.warp.collision import height_field_kernels as kernels
from mjlab_sim.warp.collision.prism_contact_kernels import Written, choose_contacts
from mjlab_sim.warp.structs import allocated, filled

_KINDS = [mjw.GeomType[name] for name in ("SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "MESH")]
_ROOM = 16
"""Prisms of each type of geom that memory holds for every contact that it holds."""
_THREADS_PER_PROCESSOR = 512
_EPA_FACES, _EPA_HORIZON = 5, 24
"""Faces of a polytope per iteration, and edges of its horizon, for which `ccd` wants memory."""


def height_field_collisions(m: mjw.Model, d: mjw.Data) -> "HeightFields | None":
  """Return the collisions of a model with its height fields; None if it has none, or MuJoCo Warp is another one."""
  if not internals.IS_TESTED:
    return None
  index = functools.partial(internals.upper_trid_index, len(mjw.GeomType), int(kernels.HFIELD))
  kinds = [kind for kind in _KINDS if m.geom_pair_type_count[index(int(kind))]]
  return HeightFields(m, d, kinds) if kinds else None


class HeightFields:
  """Collisions of geoms of the types `kinds` with height fields.

  Args:
    m: Model.
    d: Data; its sizes may change.
    kinds: Types of geoms that may touch a height field.
  """

  def __init__(self, m: mjw.Model, d: mjw.Data, kinds: Sequence[int]) -> None:
    self._device: Any = d.qpos.device
    self._kernels = [kernels.make_collide(kind, i, m.opt.ccd_iterations) for i, kind in enumerate(kinds)]
    self._lists = [kinds.index(kind) if kind in kinds else -1 for kind in range(max(kinds) + 1)]
    self._iterations = m.opt.ccd_iterations
    self._build(d)

  def _build(self, d: mjw.Data) -> None:
    self._naconmax = d.naconmax
    self._threads = min(d.naconmax, _THREADS_PER_PROCESSOR * self._device.sm_count) if self._device.is_cuda else 1
    threads, iterations, room = self._threads, self._iterations, int(_ROOM * d.naconmax)
    of_prisms = dict.fromkeys(("place", "dist", "pos", "normal"), room * len(self._kernels))
    of_pairs = dict.fromkeys(("first", "number"), d.naconmax)
    of_faces = dict.fromkeys(("face", "pr", "norm2"), (threads, 6 + _EPA_FACES * iterations))
    of_vertices = dict.fromkeys(("vert", "vert_index"), (threads, 10 + 2 * iterations))
    with wp.ScopedDevice(self._device):
      self._prisms = allocated(kernels.Prisms, count=len(self._kernels), **of_prisms, **of_pairs)
      self._prisms.room = room
      self._prisms.list_of_type = wp.array(self._lists, dtype=int)
      self._memory = allocated(kernels.Polytopes, horizon=(threads, _EPA_HORIZON), **of_faces, **of_vertices)

  def narrowphase(self, m: mjw.Model, d: mjw.Data, pairs: Any, types: Sequence[tuple[int, int]]) -> None:
    """Find the contacts of convex geoms, as MuJoCo Warp's `convex_narrowphase` does.

    Args:
      m: Model.
      d: Data.
      pairs: Pairs of geoms that may touch.
      types: Types of geoms whose pairs are to be collided.
    """
    if d.naconmax != self._naconmax:
      self._build(d)
    scene = filled(kernels.Scene, m, d, pairs)
    self._prisms.count.zero_()
    given = scene, self._prisms
    wp.launch(kernels.find_prisms, dim=d.naconmax, inputs=[*given, d.overflow])
    for kernel in self._kernels:
      wp.launch(kernel, dim=self._threads, inputs=[*given, self._memory, self._threads, d.overflow])
    wp.launch(choose_contacts, dim=d.naconmax, inputs=[*given, filled(Written, m, d), d.overflow])
    internals.convex_narrowphase(m, d, pairs, [pair for pair in types if kernels.HFIELD not in pair])
