"""Kernels of `GroupedBroadphase`: boxes around groups of moving geoms, and the pairs that may touch."""

from collections.abc import Callable
from functools import cache
from typing import Any

import mujoco
import warp as wp

from mjlab_sim.warp import internals
from mjlab_sim.warp.structs import with_arrays

FAR = wp.constant(float(mujoco.mjMAXVAL))
ROUNDING = wp.constant(1e-5)
"""Error of the distance of two boxes, as a share of their places and sizes: a hundred roundings."""


@wp.struct
class Pairs:
  """Pairs of geoms in rows: one geom that stays in place and a group of geoms that move."""

  geoms: wp.array[wp.vec2i]
  """Geoms of each pair, ordered by row, (number of pairs,)."""
  pairid: wp.array[wp.vec2i]
  """Explicit pair and sensor of each pair, as in MuJoCo Warp's `nxn_pairid`, (number of pairs,)."""
  row: wp.array[wp.vec4i]
  """Geom that stays, group, first pair, number of pairs; a group of -1 stands for pairs that are all tested."""
  first: wp.array[int]
  """First member of each group, and the number of all members, (number of groups + 1,)."""
  member: wp.array[int]
  """Geoms of all groups, group by group."""
  center: wp.array2d[wp.vec3]
  """Center of the box around a group, along the axes of the world, (num_envs, number of groups) [m]."""
  half: wp.array2d[wp.vec3]
  """Half of the edges of that box [m]."""


@with_arrays(
  "geom_type geom_dataid geom_aabb geom_rbound geom_margin geom_gap pair_margin pair_gap geom_xpos geom_xmat"
)
class Geoms:
  """Geoms of all worlds."""


@wp.func
def _margin(g: Geoms, world: int, geom: int):
  return g.geom_margin[world % g.geom_margin.shape[0], geom] + g.geom_gap[world % g.geom_gap.shape[0], geom]


@wp.func
def _absolute(v: wp.vec3):
  return wp.vec3(wp.abs(v[0]), wp.abs(v[1]), wp.abs(v[2]))


@wp.kernel(enable_backward=False)
def bound_groups(g: Geoms, p: Pairs):
  """Find the box around each group: the boxes of its geoms with their margins."""
  world, group = wp.tid()
  low, high = wp.vec3(FAR), wp.vec3(-FAR)
  for i in range(p.first[group], p.first[group + 1]):
    geom = p.member[i]
    box = world % g.geom_aabb.shape[0]
    rotation, size = g.geom_xmat[world, geom], g.geom_aabb[box, geom, 1]
    center = g.geom_xpos[world, geom] + rotation @ g.geom_aabb[box, geom, 0]
    half = wp.vec3(wp.max(_margin(g, world, geom), 0.0))
    for axis in range(3):
      half += size[axis] * _absolute(wp.vec3(rotation[0, axis], rotation[1, axis], rotation[2, axis]))
    if g.geom_rbound[world % g.geom_rbound.shape[0], geom] == 0.0:
      half = wp.vec3(FAR)
    low, high = wp.min(low, center - half), wp.max(high, center + half)
  p.center[world, group] = 0.5 * (low + high)
  p.half[world, group] = 0.5 * (high - low)


@wp.func
def _is_apart(g: Geoms, p: Pairs, world: int, geom: int, group: int):
  """Return True if an axis of the geom's box parts it from the box of a group, and so from each geom in it."""
  if g.geom_rbound[world % g.geom_rbound.shape[0], geom] == 0.0:
    return False
  box = world % g.geom_aabb.shape[0]
  rotation, size = g.geom_xmat[world, geom], g.geom_aabb[box, geom, 1]
  at = g.geom_xpos[world, geom] + rotation @ g.geom_aabb[box, geom, 0]
  center, half = p.center[world, group], p.half[world, group]
  slack = ROUNDING * (1.0 + wp.length(at) + wp.length(size) + wp.length(center) + wp.length(half))
  for i in range(3):
    axis = wp.vec3(rotation[0, i], rotation[1, i], rotation[2, i])
    reach = size[i] + wp.dot(half, _absolute(axis)) + _margin(g, world, geom)
    if wp.abs(wp.dot(center - at, axis)) > reach + slack:
      return True
  return False


@cache
def make_find_pairs(*tests: int) -> Callable[..., Any]:
  """Make the kernel that lists the pairs that may touch, with one thread for each row of a world.

  Args:
    tests: Tests of a pair and the number of worlds of each model field, as MuJoCo Warp's filter wants them.
  """
  may_touch = internals.broadphase_filter(*tests)

  @wp.kernel(module="unique", enable_backward=False)
  def find_pairs(
    g: Geoms,
    p: Pairs,
    room: int,
    count: wp.array[int],
    found: wp.array[wp.vec2i],
    found_pairid: wp.array[wp.vec2i],
    found_world: wp.array[int],
  ):
    world, number = wp.tid()
    row = p.row[number]
    if row[1] >= 0 and _is_apart(g, p, world, row[0], row[1]):
      return
    data = world % g.geom_dataid.shape[0]
    for i in range(row[2], row[2] + row[3]):
      geom1, geom2, pairid = p.geoms[i][0], p.geoms[i][1], p.pairid[i]
      type1, type2 = g.geom_type[geom1], g.geom_type[geom2]
      if internals.mesh_missing(g.geom_dataid, geom1, type1, data):
        continue
      if internals.mesh_missing(g.geom_dataid, geom2, type2, data):
        continue
      if pairid[1] >= 0 or may_touch(
        g.geom_aabb,
        g.geom_rbound,
        g.geom_margin,
        g.geom_gap,
        g.pair_margin,
        g.pair_gap,
        g.geom_xpos,
        g.geom_xmat,
        geom1,
        geom2,
        pairid[0],
        world,
      ):
        internals.add_geom_pair(
          room, geom1, geom2, type1, type2, world, pairid, count, found, found_pairid, found_world
        )

  return find_pairs
