"""Kernels of `HeightFields`: find the prisms under geoms, and collide each.

A cell of a height field is two prisms. The rules are those of MuJoCo Warp's own kernel, which follows MuJoCo's
`mjc_ConvexHField`.
"""

from typing import Any

import mujoco
import mujoco_warp as mjw
import warp as wp

from mjlab_sim.warp import internals
from mjlab_sim.warp.structs import with_arrays

_mat63: Any = wp.types.matrix(shape=(6, 3), dtype=float)
HFIELD = wp.constant(int(mujoco.mjtGeom.mjGEOM_HFIELD))
MESH = wp.constant(int(mujoco.mjtGeom.mjGEOM_MESH))
CCD_OVERFLOW = wp.constant(int(mjw.OverflowType.CCD))
FAR = wp.constant(float(mujoco.mjMAXVAL))
CLEAR = wp.constant(1e-4)
"""Distance from a prism's top that no rounding turns into a contact [m]."""


@with_arrays(
  """ccd_tolerance geom_type geom_condim geom_dataid geom_priority geom_solmix geom_solref geom_solimp geom_size
  geom_rbound geom_friction geom_margin geom_gap geom_adhesion mesh_vertadr mesh_vertnum mesh_graphadr mesh_vert
  mesh_graph mesh_polynum mesh_polyadr mesh_polynormal mesh_polyvertadr mesh_polyvertnum mesh_polyvert
  mesh_polymapadr mesh_polymapnum mesh_polymap hfield_size hfield_nrow hfield_ncol hfield_adr hfield_data pair_dim
  pair_solref pair_solreffriction pair_solimp pair_margin pair_gap pair_adhesion pair_friction geom_xpos geom_xmat
  ncollision"""
)
class Scene:
  """Geoms and height fields, and the pairs of geoms that may touch."""

  collision_pair: wp.array[wp.vec2i]
  collision_pairid: wp.array[wp.vec2i]
  collision_worldid: wp.array[int]


@wp.struct
class Prisms:
  """Prisms that geoms may touch, of one kind of geom after another, each kind with room for `room` of them."""

  room: int
  list_of_type: wp.array[int]
  """List of a type of geom, -1 for a type that has none."""
  count: wp.array[int]
  """Prisms of each list."""
  first: wp.array[int]
  """First prism of a pair of geoms."""
  number: wp.array[int]
  """Prisms of a pair of geoms."""
  place: wp.array[wp.vec2i]
  """Pair of geoms, and cell of the height field times two plus the number of the prism in it; -1 for no prism."""
  dist: wp.array[float]
  """Distance of the geom, large without a contact [m]."""
  pos: wp.array[wp.vec3]
  normal: wp.array[wp.vec3]


@wp.struct
class Polytopes:
  """Memory of the expanding polytope of each thread."""

  vert: wp.array2d[wp.vec3]
  vert_index: wp.array2d[int]
  face: wp.array2d[int]
  pr: wp.array2d[wp.vec3]
  norm2: wp.array2d[float]
  horizon: wp.array2d[int]


@wp.func
def _corner(s: Scene, field: int, row: int, place: int):
  """Return a corner of a strip of prisms; corners alternate between the two rows of points that bound it."""
  size, nrow, ncol = s.hfield_size[field], s.hfield_nrow[field], s.hfield_ncol[field]
  column, at = place / 2, row + 1 - place % 2
  x = ((2.0 * size[0]) / float(ncol - 1)) * float(column) - size[0]
  y = ((2.0 * size[1]) / float(nrow - 1)) * float(at) - size[1]
  return wp.vec3(x, y, s.hfield_data[s.hfield_adr[field] + at * ncol + column] * size[2])


@wp.func
def _prism(s: Scene, field: int, row: int, place: int, margin: float):
  """Return the corners of a prism, (6, 3): its bottom, then its top raised by the margin."""
  prism = _mat63()
  for i in range(3):
    corner = _corner(s, field, row, place - 2 + i)
    prism[i] = wp.vec3(corner[0], corner[1], -s.hfield_size[field][3])
    prism[i + 3] = wp.vec3(corner[0], corner[1], corner[2] + margin)
  return prism


@wp.func
def _field(s: Scene, world: int, geom: int):
  return s.geom_dataid[world % s.geom_dataid.shape[0], geom]


@wp.func
def _geoms(s: Scene, geoms: wp.vec2i, world: int):
  """Return height field and geom, in the frame of the height field."""
  field, geom = internals.geom_collision_pair(
    s.geom_type,
    s.geom_dataid,
    s.geom_size,
    s.mesh_vertadr,
    s.mesh_vertnum,
    s.mesh_graphadr,
    s.mesh_vert,
    s.mesh_graph,
    s.mesh_polynum,
    s.mesh_polyadr,
    s.mesh_polynormal,
    s.mesh_polyvertadr,
    s.mesh_polyvertnum,
    s.mesh_polyvert,
    s.mesh_polymapadr,
    s.mesh_polymapnum,
    s.mesh_polymap,
    s.geom_xpos,
    s.geom_xmat,
    geoms,
    world,
  )
  turn = wp.transpose(field.rot)
  geom.pos = turn @ (geom.pos - field.pos)
  geom.rot = turn @ geom.rot
  field.pos = wp.vec3(0.0, 0.0, 0.0)
  field.rot = wp.identity(n=3, dtype=float)
  return field, geom


@wp.func
def margin_gap(s: Scene, geoms: wp.vec2i, pair: int, world: int):
  """Return the margin and the gap of a pair's contacts."""
  pairid = s.collision_pairid[pair][0]
  return internals.contact_margin_gap(s.geom_margin, s.geom_gap, s.pair_margin, s.pair_gap, geoms, pairid, world)


@wp.func
def _is_clear(prism: _mat63, geom: Any, kind: int, clear: float):
  """Return True if a geom is above the plane of a prism's top, by more than `clear`."""
  a = prism[3]
  normal = wp.normalize(wp.cross(prism[4] - a, prism[5] - a))
  if normal[2] < 0.0:
    normal = -normal
  lowest = internals.support(geom, kind, -normal)
  return wp.dot(lowest.point - a, normal) > clear


@wp.func
def _may_touch(prism: _mat63, geom: Any, kind: int, lowest: float, clear: float):
  if prism[3, 2] < lowest and prism[4, 2] < lowest and prism[5, 2] < lowest:
    return False
  # The support of a mesh is a search. It costs as much as the collision of a prism that is clear.
  return kind == MESH or not _is_clear(prism, geom, kind, clear)


@wp.kernel(enable_backward=False)
def find_prisms(s: Scene, prisms: Prisms, overflow: wp.array[int]):
  """List the prisms under the geoms of each pair."""
  pair = wp.tid()
  prisms.number[pair] = 0
  if pair >= s.ncollision[0]:
    return
  geoms = s.collision_pair[pair]
  if s.geom_type[geoms[0]] != HFIELD:
    return
  world = s.collision_worldid[pair]
  is_apart, xmin, xmax, ymin, ymax, zmin, _zmax = internals.hfield_filter(
    s.geom_type,
    s.geom_dataid,
    s.geom_size,
    s.geom_rbound,
    s.geom_margin,
    s.mesh_vertadr,
    s.mesh_vertnum,
    s.mesh_graphadr,
    s.mesh_vert,
    s.mesh_graph,
    s.hfield_size,
    s.geom_xpos,
    s.geom_xmat,
    world,
    geoms[0],
    geoms[1],
  )
  if is_apart:
    return
  kind = s.geom_type[geoms[1]]
  margin, gap = margin_gap(s, geoms, pair, world)
  _ground, geom = _geoms(s, geoms, world)
  clear = 2.0 * margin + gap + CLEAR
  field = _field(s, world, geoms[0])
  size, nrow, ncol = s.hfield_size[field], s.hfield_nrow[field], s.hfield_ncol[field]
  x_scale, y_scale = 0.5 * float(ncol - 1) / size[0], 0.5 * float(nrow - 1) / size[1]
  left = wp.max(0, int(wp.floor((xmin + size[0]) * x_scale)))
  right = wp.min(ncol - 1, int(wp.ceil((xmax + size[0]) * x_scale)))
  low = wp.max(0, int(wp.floor((ymin + size[1]) * y_scale)))
  high = wp.min(nrow - 1, int(wp.ceil((ymax + size[1]) * y_scale)))

  number = wp.int32(0)
  for row in range(low, high):
    for place in range(2 * left + 2, 2 * right + 2):
      if _may_touch(_prism(s, field, row, place, margin), geom, kind, zmin, clear):
        number += 1
  if number == 0:
    return
  which = prisms.list_of_type[kind]
  first = wp.atomic_add(prisms.count, which, number)
  if first + number > prisms.room:
    wp.atomic_or(overflow, world, CCD_OVERFLOW)
    for i in range(first, prisms.room):
      prisms.place[which * prisms.room + i] = wp.vec2i(-1, -1)
    return
  at = which * prisms.room + first
  prisms.first[pair] = at
  prisms.number[pair] = number
  for row in range(low, high):
    for place in range(2 * left + 2, 2 * right + 2):
      if _may_touch(_prism(s, field, row, place, margin), geom, kind, zmin, clear):
        prisms.place[at] = wp.vec2i(pair, 2 * ncol * row + place)
        at += 1


def make_collide(kind: int, which: int, iterations: int) -> Any:
  """Return the kernel that collides the prisms of list `which`, under geoms of type `kind`."""

  @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
  def collide_prisms(s: Scene, prisms: Prisms, memory: Polytopes, threads: int, overflow: wp.array[int]):
    thread = wp.tid()
    first = wp.static(which) * prisms.room
    for i in range(first + thread, first + wp.min(prisms.count[wp.static(which)], prisms.room), threads):
      place = prisms.place[i]
      pair = place[0]
      if pair < 0:
        continue
      geoms, world = s.collision_pair[pair], s.collision_worldid[pair]
      margin, gap = margin_gap(s, geoms, pair, world)
      ground, geom = _geoms(s, geoms, world)
      geom.margin = margin
      field = _field(s, world, geoms[0])
      strip = 2 * s.hfield_ncol[field]
      prism = _prism(s, field, place[1] / strip, place[1] % strip, margin)
      ground.polyvert = prism
      center = (prism[0] + prism[1] + prism[2] + prism[3] + prism[4] + prism[5]) * wp.static(1.0 / 6.0)
      dist, number, on_ground, on_geom, _face = internals.ccd(
        s.ccd_tolerance[world % s.ccd_tolerance.shape[0]],
        0.0,
        wp.static(iterations),
        wp.static(iterations),
        ground,
        geom,
        wp.static(HFIELD),
        wp.static(kind),
        center,
        geom.pos,
        memory.vert[thread],
        memory.vert_index[thread],
        memory.face[thread],
        memory.pr[thread],
        memory.norm2[thread],
        memory.horizon[thread],
        False,
        world,
        overflow,
      )
      prisms.dist[i] = FAR
      # Prisms apart from the geom count as one contact, too.
      if number > 0 and dist < margin + gap:
        turn = s.geom_xmat[world, geoms[0]]
        frame = internals.make_frame(on_ground - on_geom)
        prisms.dist[i] = dist
        prisms.pos[i] = turn @ (0.5 * (on_ground + on_geom)) + s.geom_xpos[world, geoms[0]]
        prisms.normal[i] = turn @ wp.vec3(frame[0, 0], frame[0, 1], frame[0, 2])

  return collide_prisms
