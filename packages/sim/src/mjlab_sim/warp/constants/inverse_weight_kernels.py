"""Kernels of `InverseWeights`.

Row i of the inertia matrix M holds dof i's ancestors from the root down, and i itself last: entry k of the row is at
`rowadr[i] + k` and in the column `colind` there, and the row of that column begins with the same k + 1 columns. `root`
has these entries too. It is the triangular R of inv(M) = R R'.
"""

import mujoco
import warp as wp

from mjlab_sim.warp.structs import with_arrays

FREE = wp.constant(int(mujoco.mjtJoint.mjJNT_FREE))
BALL = wp.constant(int(mujoco.mjtJoint.mjJNT_BALL))


@wp.func_native("WP_TILE_SYNC();")
def sync() -> None:
  """Wait for the other threads of the block, and make their writes visible."""


@with_arrays(
  """M M_rownnz M_rowadr M_colind dof_bodyid dof_jntid dof_parentid jnt_type jnt_dofadr body_mass body_parentid
  body_rootid body_dofadr body_dofnum subtree_com xipos cdof ten_J ten_J_rownnz ten_J_rowadr ten_J_colind
  actuator_moment moment_rownnz moment_rowadr moment_colind dof_invweight0 body_invweight0 tendon_invweight0
  actuator_acc0"""
)
class Worlds:
  """Worlds at the reference pose."""

  mask: wp.array[bool]
  """Worlds whose weights are written."""
  is_slider: wp.array[bool]
  """Bodies that only slide along their parent's axes."""
  above: wp.array[int]
  """Place at which the row of each entry's column begins."""
  pairs: wp.array[wp.vec2i]
  """All (a, b) with b <= a, ordered by a."""
  longest: int
  """Number of entries of the longest row."""
  num_shared: wp.array2d[int]
  """Number of entries that the rows of two dofs begin with in common."""
  root: wp.array2d[float]


# A separate module: a module is compiled once for every size of block that its kernels are launched with.
@wp.kernel(enable_backward=False, module="unique")
def invert_inertia(w: Worlds):
  """Find `root` by one block of threads for each world; `M` is left as D L, where M = L' D L.

  The factorisation is that of Featherstone (2008), Rigid Body Dynamics Algorithms, section 6.5.
  """
  world, thread = wp.tid()
  if not w.mask[world]:
    return
  inertia, root = w.M, w.root
  nv = w.M_rownnz.shape[0]
  # A step reads the row of its dof, writes to rows of ancestors only, and to each entry from one thread.
  for back in range(nv):
    i = nv - 1 - back
    adr = w.M_rowadr[i]
    last = w.M_rownnz[i] - 1
    scale = 1.0 / inertia[world, adr + last]
    for p in range(thread, last * (last + 1) // 2, wp.block_dim()):
      a = w.pairs[p][0]
      b = w.pairs[p][1]
      to = w.above[adr + a] + b
      # Not "-=", which Warp makes an atomic of.
      inertia[world, to] = inertia[world, to] - inertia[world, adr + a] * scale * inertia[world, adr + b]
    sync()
  # inv(L) inv(sqrt(D)), row by row down the tree. Entry a of a row follows from the entries a of rows above: a thread
  # reads of `root` only its own writes.
  for a in range(thread, w.longest, wp.block_dim()):
    for i in range(nv):
      adr = w.M_rowadr[i]
      last = w.M_rownnz[i] - 1
      if a == last:
        root[world, adr + a] = 1.0 / wp.sqrt(inertia[world, adr + a])
      elif a < last:
        total = wp.float32(0.0)
        for k in range(a, last):
          total += inertia[world, adr + k] * root[world, w.above[adr + k] + a]
        root[world, adr + a] = -total / inertia[world, adr + last]


@wp.func
def respond(w: Worlds, world: int, i: int, j: int) -> float:
  """Return inv(M)[i, j]: two rows of R have their first entries in common, those of shared ancestors."""
  total = wp.float32(0.0)
  for k in range(w.num_shared[i, j]):
    total += w.root[world, w.M_rowadr[i] + k] * w.root[world, w.M_rowadr[j] + k]
  return total


@wp.func
def slider_weight(w: Worlds, world: int, body: int) -> float:
  """Return the inverse mass, which MuJoCo gives to bodies that only slide, armature or not."""
  return 1.0 / w.body_mass[world % w.body_mass.shape[0], body]


@wp.kernel(enable_backward=False)
def weigh_dofs(w: Worlds):
  """Write the inverse weight of each dof; the three that turn a body, or move it, have their mean."""
  world, dof = wp.tid()
  if not w.mask[world]:
    return
  body = w.dof_bodyid[dof]
  if w.is_slider[body]:
    w.dof_invweight0[world, dof] = slider_weight(w, world, body)
    return
  joint = w.dof_jntid[dof]
  first = wp.int32(dof)
  count = wp.int32(1)
  if w.jnt_type[joint] == FREE or w.jnt_type[joint] == BALL:
    count = 3
    first = w.jnt_dofadr[joint] + 3 * ((dof - w.jnt_dofadr[joint]) // 3)
  total = wp.float32(0.0)
  for i in range(first, first + count):
    total += respond(w, world, i, i)
  w.dof_invweight0[world, dof] = total / wp.float32(count)


@wp.kernel(enable_backward=False)
def weigh_bodies(w: Worlds):
  """Write the mean over the axes of (translation, rotation) at each body's centre of mass; 0 for fixed bodies."""
  world, body = wp.tid()
  if not w.mask[world]:
    return
  if w.is_slider[body]:
    w.body_invweight0[world, body] = wp.vec2(slider_weight(w, world, body), 0.0)
    return
  weight = wp.vec2(0.0, 0.0)
  mover = wp.int32(body)
  while mover > 0 and w.body_dofnum[mover] == 0:
    mover = w.body_parentid[mover]
  if mover > 0:
    offset = w.xipos[world, body] - w.subtree_com[world, w.body_rootid[body]]
    dof = w.body_dofadr[mover] + w.body_dofnum[mover] - 1
    # Once, but for bodies so simple that their part of M is diagonal: their rows do not hold their other dofs.
    while dof >= 0:
      adr = w.M_rowadr[dof]
      for a in range(w.M_rownnz[dof]):
        motion = wp.spatial_vector()
        for k in range(a, w.M_rownnz[dof]):
          i = w.M_colind[adr + k]
          motion += w.root[world, w.M_rowadr[i] + a] * w.cdof[world, i]
        turn = wp.spatial_top(motion)
        move = wp.spatial_bottom(motion) + wp.cross(turn, offset)
        weight += wp.vec2(wp.dot(move, move), wp.dot(turn, turn)) / 3.0
      dof = w.dof_parentid[w.M_colind[adr]]
  w.body_invweight0[world, body] = weight


@wp.kernel(enable_backward=False)
def weigh_tendons(w: Worlds):
  """Write the inverse weight of each tendon."""
  world, tendon = wp.tid()
  if not w.mask[world]:
    return
  first = w.ten_J_rowadr[tendon]
  end = first + w.ten_J_rownnz[tendon]
  total = wp.float32(0.0)
  for j in range(first, end):
    for k in range(first, end):
      response = respond(w, world, w.ten_J_colind[j], w.ten_J_colind[k])
      total += w.ten_J[world, j] * response * w.ten_J[world, k]
  w.tendon_invweight0[world, tendon] = total


@wp.kernel(enable_backward=False)
def accelerate(w: Worlds):
  """Write the length of the joint acceleration that one unit of each actuator's force makes."""
  world, actuator = wp.tid()
  if not w.mask[world]:
    return
  first = w.moment_rowadr[world, actuator]
  end = first + w.moment_rownnz[world, actuator]
  total = wp.float32(0.0)
  for i in range(w.M_rowadr.shape[0]):
    acceleration = wp.float32(0.0)
    for j in range(first, end):
      acceleration += w.actuator_moment[world, j] * respond(w, world, i, w.moment_colind[world, j])
    total += acceleration * acceleration
  w.actuator_acc0[world, actuator] = wp.sqrt(total)
