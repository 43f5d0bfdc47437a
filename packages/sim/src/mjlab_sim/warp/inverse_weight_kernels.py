"""Kernels of `InverseWeights`.

Row i of the inertia matrix M holds dof i's ancestors from the root down, and i itself last: entry k of the row is at
`rowadr[i] + k` and in the column `colind` there, and the row of that column begins with the same k + 1 columns. `root`
has these entries too. It is the triangular R of inv(M) = R R'.
"""

import mujoco
import warp as wp

FREE = wp.constant(int(mujoco.mjtJoint.mjJNT_FREE))
BALL = wp.constant(int(mujoco.mjtJoint.mjJNT_BALL))


@wp.func_native("WP_TILE_SYNC();")
def sync() -> None:
  """Wait for the other threads of the block; what each wrote before, all see afterwards."""


@wp.kernel(enable_backward=False)
def rest(qpos0: wp.array2d[float], qpos: wp.array2d[float]):
  """Write the reference pose of every world."""
  world, column = wp.tid()
  qpos[world, column] = qpos0[world % qpos0.shape[0], column]


# A module of its own: a module is compiled once for every size of block that its kernels are launched with.
@wp.kernel(enable_backward=False, module="unique")
def invert_inertia(
  mask: wp.array[bool],
  rownnz: wp.array[int],
  rowadr: wp.array[int],
  above: wp.array[int],
  pairs: wp.array[wp.vec2i],
  longest: int,
  inertia: wp.array2d[float],
  root: wp.array2d[float],
):
  """R of inv(M) = R R', by one block of threads for each world; `inertia` is left as D L, where M = L' D L.

  `above` is where the row of each entry's column begins, `pairs` are all (a, b) with b <= a, ordered by a, and
  `longest` is the number of entries of the longest row.
  The factorisation is that of Featherstone (2008), Rigid Body Dynamics Algorithms, section 6.5.
  """
  world, thread = wp.tid()
  if not mask[world]:
    return
  nv = rownnz.shape[0]
  # A step reads the row of its dof, writes to rows of ancestors only, and to each entry from one thread.
  for back in range(nv):
    i = nv - 1 - back
    adr = rowadr[i]
    last = rownnz[i] - 1
    scale = 1.0 / inertia[world, adr + last]
    for p in range(thread, last * (last + 1) // 2, wp.block_dim()):
      a = pairs[p][0]
      b = pairs[p][1]
      to = above[adr + a] + b
      # Not "-=", which Warp makes an atomic of.
      inertia[world, to] = inertia[world, to] - inertia[world, adr + a] * scale * inertia[world, adr + b]
    sync()
  # inv(L) inv(sqrt(D)), row by row down the tree. Entry a of a row follows from the entries a of rows above: what a
  # thread reads of `root` is what it wrote itself.
  for a in range(thread, longest, wp.block_dim()):
    for i in range(nv):
      adr = rowadr[i]
      last = rownnz[i] - 1
      if a == last:
        root[world, adr + a] = 1.0 / wp.sqrt(inertia[world, adr + a])
      elif a < last:
        total = wp.float32(0.0)
        for k in range(a, last):
          total += inertia[world, adr + k] * root[world, above[adr + k] + a]
        root[world, adr + a] = -total / inertia[world, adr + last]


@wp.func
def respond(
  world: int, i: int, j: int, rowadr: wp.array[int], num_shared: wp.array2d[int], root: wp.array2d[float]
) -> float:
  """inv(M)[i, j]: rows of R have in common what they begin with, their `num_shared` ancestors."""
  total = wp.float32(0.0)
  for k in range(num_shared[i, j]):
    total += root[world, rowadr[i] + k] * root[world, rowadr[j] + k]
  return total


@wp.kernel(enable_backward=False)
def weigh_dofs(
  mask: wp.array[bool],
  rowadr: wp.array[int],
  num_shared: wp.array2d[int],
  root: wp.array2d[float],
  dof_jntid: wp.array[int],
  jnt_type: wp.array[int],
  jnt_dofadr: wp.array[int],
  dof_bodyid: wp.array[int],
  is_slider: wp.array[bool],
  body_mass: wp.array2d[float],
  dof_invweight0: wp.array2d[float],
):
  """Of the three dofs that turn a body, or move it, each has their mean."""
  world, dof = wp.tid()
  if not mask[world]:
    return
  body = dof_bodyid[dof]
  if is_slider[body]:
    dof_invweight0[world, dof] = 1.0 / body_mass[world % body_mass.shape[0], body]
    return
  joint = dof_jntid[dof]
  first = wp.int32(dof)
  count = wp.int32(1)
  if jnt_type[joint] == FREE or jnt_type[joint] == BALL:
    count = 3
    first = jnt_dofadr[joint] + 3 * ((dof - jnt_dofadr[joint]) // 3)
  total = wp.float32(0.0)
  for i in range(first, first + count):
    total += respond(world, i, i, rowadr, num_shared, root)
  dof_invweight0[world, dof] = total / wp.float32(count)


@wp.kernel(enable_backward=False)
def weigh_bodies(
  mask: wp.array[bool],
  rowadr: wp.array[int],
  root: wp.array2d[float],
  rownnz: wp.array[int],
  colind: wp.array[int],
  is_slider: wp.array[bool],
  body_mass: wp.array2d[float],
  body_parentid: wp.array[int],
  body_rootid: wp.array[int],
  body_dofadr: wp.array[int],
  body_dofnum: wp.array[int],
  dof_parentid: wp.array[int],
  subtree_com: wp.array2d[wp.vec3],
  xipos: wp.array2d[wp.vec3],
  cdof: wp.array2d[wp.spatial_vector],
  body_invweight0: wp.array2d[wp.vec2],
):
  """Mean over the axes of (translation, rotation) at the body's centre of mass; 0 for bodies that never move."""
  world, body = wp.tid()
  if not mask[world]:
    return
  if is_slider[body]:
    body_invweight0[world, body] = wp.vec2(1.0 / body_mass[world % body_mass.shape[0], body], 0.0)
    return
  weight = wp.vec2(0.0, 0.0)
  mover = wp.int32(body)
  while mover > 0 and body_dofnum[mover] == 0:
    mover = body_parentid[mover]
  if mover > 0:
    offset = xipos[world, body] - subtree_com[world, body_rootid[body]]
    dof = body_dofadr[mover] + body_dofnum[mover] - 1
    # Once, but for bodies so simple that their part of M is diagonal: their rows do not hold their other dofs.
    while dof >= 0:
      adr = rowadr[dof]
      for a in range(rownnz[dof]):
        motion = wp.spatial_vector()
        for k in range(a, rownnz[dof]):
          i = colind[adr + k]
          motion += root[world, rowadr[i] + a] * cdof[world, i]
        turn = wp.spatial_top(motion)
        move = wp.spatial_bottom(motion) + wp.cross(turn, offset)
        weight += wp.vec2(wp.dot(move, move), wp.dot(turn, turn)) / 3.0
      dof = dof_parentid[colind[adr]]
  body_invweight0[world, body] = weight


@wp.kernel(enable_backward=False)
def weigh_tendons(
  mask: wp.array[bool],
  rowadr: wp.array[int],
  num_shared: wp.array2d[int],
  root: wp.array2d[float],
  jac_rownnz: wp.array[int],
  jac_rowadr: wp.array[int],
  jac_colind: wp.array[int],
  ten_jac: wp.array2d[float],
  tendon_invweight0: wp.array2d[float],
):
  """Write the inverse weight of each tendon."""
  world, tendon = wp.tid()
  if not mask[world]:
    return
  first = jac_rowadr[tendon]
  end = first + jac_rownnz[tendon]
  total = wp.float32(0.0)
  for j in range(first, end):
    for k in range(first, end):
      response = respond(world, jac_colind[j], jac_colind[k], rowadr, num_shared, root)
      total += ten_jac[world, j] * response * ten_jac[world, k]
  tendon_invweight0[world, tendon] = total


@wp.kernel(enable_backward=False)
def accelerate(
  mask: wp.array[bool],
  rowadr: wp.array[int],
  num_shared: wp.array2d[int],
  root: wp.array2d[float],
  moment_rownnz: wp.array2d[int],
  moment_rowadr: wp.array2d[int],
  moment_colind: wp.array2d[int],
  moment: wp.array2d[float],
  actuator_acc0: wp.array2d[float],
):
  """Length of the joint acceleration that one unit of the actuator's force makes."""
  world, actuator = wp.tid()
  if not mask[world]:
    return
  first = moment_rowadr[world, actuator]
  end = first + moment_rownnz[world, actuator]
  total = wp.float32(0.0)
  for i in range(rowadr.shape[0]):
    acceleration = wp.float32(0.0)
    for j in range(first, end):
      acceleration += moment[world, j] * respond(world, i, moment_colind[world, j], rowadr, num_shared, root)
    total += acceleration * acceleration
  actuator_acc0[world, actuator] = wp.sqrt(total)
