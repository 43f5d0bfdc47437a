"""Kernels of `InverseWeights`.

In all of them `rownnz`, `rowadr` and `colind` are the structure of the inertia matrix M = L' D L, `inverse` holds
inv(L) in the same entries, and `scale` the diagonal of inv(D).
"""

import mujoco
import warp as wp

FREE = wp.constant(int(mujoco.mjtJoint.mjJNT_FREE))
BALL = wp.constant(int(mujoco.mjtJoint.mjJNT_BALL))


@wp.kernel(enable_backward=False)
def rest(qpos0: wp.array2d[float], qpos: wp.array2d[float]):
  world, column = wp.tid()
  qpos[world, column] = qpos0[world % qpos0.shape[0], column]


@wp.kernel(enable_backward=False)
def invert_inertia(
  mask: wp.array[bool],
  rownnz: wp.array[int],
  rowadr: wp.array[int],
  colind: wp.array[int],
  inertia: wp.array2d[float],
  inverse: wp.array2d[float],
  scale: wp.array2d[float],
):
  """inv(L) without its unit diagonal, and inv(D), of M = L' D L (Featherstone 2008, Rigid Body Dynamics, section 6.5).

  Row i of all three matrices holds dof i's ancestors from the root down, and i itself last.
  """
  world = wp.tid()
  if not mask[world]:
    return
  nv = rownnz.shape[0]
  for k in range(inverse.shape[1]):
    inverse[world, k] = inertia[world, k]
  for back in range(nv):
    i = nv - 1 - back
    adr = rowadr[i]
    last = rownnz[i] - 1
    pivot = 1.0 / inverse[world, adr + last]
    scale[world, i] = pivot
    for up in range(last):
      above = last - 1 - up
      to = rowadr[colind[adr + above]]
      ratio = inverse[world, adr + above] * pivot
      for k in range(above + 1):
        # Not "-=", which Warp makes an atomic of.
        inverse[world, to + k] = inverse[world, to + k] - ratio * inverse[world, adr + k]
      inverse[world, adr + above] = ratio
  for i in range(nv):
    adr = rowadr[i]
    for a in range(rownnz[i] - 1):
      value = inverse[world, adr + a]
      for k in range(a + 1, rownnz[i] - 1):
        value += inverse[world, adr + k] * inverse[world, rowadr[colind[adr + k]] + a]
      inverse[world, adr + a] = -value


@wp.func
def entry(
  world: int,
  i: int,
  a: int,
  rownnz: wp.array[int],
  rowadr: wp.array[int],
  colind: wp.array[int],
  inverse: wp.array2d[float],
) -> float:
  """inv(L)[i, a]: 1 on the diagonal, 0 unless a is an ancestor of i; as deep in i's row as in its own."""
  if a == i:
    return 1.0
  depth = rownnz[a] - 1
  if depth < rownnz[i] and colind[rowadr[i] + depth] == a:
    return inverse[world, rowadr[i] + depth]
  return 0.0


@wp.func
def weigh_dof(
  world: int,
  i: int,
  rownnz: wp.array[int],
  rowadr: wp.array[int],
  colind: wp.array[int],
  inverse: wp.array2d[float],
  scale: wp.array2d[float],
) -> float:
  """inv(M)[i, i]."""
  total = scale[world, i]
  for k in range(rownnz[i] - 1):
    value = inverse[world, rowadr[i] + k]
    total += value * value * scale[world, colind[rowadr[i] + k]]
  return total


@wp.kernel(enable_backward=False)
def weigh_dofs(
  mask: wp.array[bool],
  rownnz: wp.array[int],
  rowadr: wp.array[int],
  colind: wp.array[int],
  inverse: wp.array2d[float],
  scale: wp.array2d[float],
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
  for i in range(count):
    total += weigh_dof(world, first + i, rownnz, rowadr, colind, inverse, scale)
  dof_invweight0[world, dof] = total / wp.float32(count)


@wp.kernel(enable_backward=False)
def weigh_bodies(
  mask: wp.array[bool],
  rownnz: wp.array[int],
  rowadr: wp.array[int],
  colind: wp.array[int],
  inverse: wp.array2d[float],
  scale: wp.array2d[float],
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
    leaf = body_dofadr[mover] + body_dofnum[mover] - 1
    a = wp.int32(leaf)
    while a >= 0:
      turn = wp.vec3()
      move = wp.vec3()
      i = wp.int32(leaf)
      while i >= a:
        factor = entry(world, i, a, rownnz, rowadr, colind, inverse)
        axis = wp.spatial_top(cdof[world, i])
        turn += factor * axis
        move += factor * (wp.spatial_bottom(cdof[world, i]) + wp.cross(axis, offset))
        i = dof_parentid[i]
      weight += scale[world, a] / 3.0 * wp.vec2(wp.dot(move, move), wp.dot(turn, turn))
      a = dof_parentid[a]
  body_invweight0[world, body] = weight


@wp.kernel(enable_backward=False)
def weigh_tendons(
  mask: wp.array[bool],
  rownnz: wp.array[int],
  rowadr: wp.array[int],
  colind: wp.array[int],
  inverse: wp.array2d[float],
  scale: wp.array2d[float],
  jac_rownnz: wp.array[int],
  jac_rowadr: wp.array[int],
  jac_colind: wp.array[int],
  ten_jac: wp.array2d[float],
  tendon_invweight0: wp.array2d[float],
):
  world, tendon = wp.tid()
  if not mask[world]:
    return
  total = wp.float32(0.0)
  adr = jac_rowadr[tendon]
  for a in range(rownnz.shape[0]):
    value = wp.float32(0.0)
    for k in range(jac_rownnz[tendon]):
      value += ten_jac[world, adr + k] * entry(world, jac_colind[adr + k], a, rownnz, rowadr, colind, inverse)
    total += value * value * scale[world, a]
  tendon_invweight0[world, tendon] = total


@wp.kernel(enable_backward=False)
def accelerate(
  mask: wp.array[bool],
  rownnz: wp.array[int],
  rowadr: wp.array[int],
  colind: wp.array[int],
  inverse: wp.array2d[float],
  scale: wp.array2d[float],
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
  adr = moment_rowadr[world, actuator]
  total = wp.float32(0.0)
  for i in range(rownnz.shape[0]):
    acceleration = wp.float32(0.0)
    for k in range(rownnz[i]):
      a = colind[rowadr[i] + k]
      force = wp.float32(0.0)
      for j in range(moment_rownnz[world, actuator]):
        dof = moment_colind[world, adr + j]
        force += moment[world, adr + j] * entry(world, dof, a, rownnz, rowadr, colind, inverse)
      acceleration += entry(world, i, a, rownnz, rowadr, colind, inverse) * scale[world, a] * force
    total += acceleration * acceleration
  actuator_acc0[world, actuator] = wp.sqrt(total)
