"""Kernels of `HeightFields`: find the prisms under a geom, collide each, and choose contacts among them.

A cell of a height field is two prisms. The rules are those of MuJoCo Warp's own kernel, which follows MuJoCo's
`mjc_ConvexHField`.
"""

from typing import Any

import mujoco
import mujoco_warp as mjw
import warp as wp

from mjlab_sim.warp import internals

_vec5: Any = wp.types.vector(length=5, dtype=float)
_mat63: Any = wp.types.matrix(shape=(6, 3), dtype=float)
HFIELD = wp.constant(int(mujoco.mjtGeom.mjGEOM_HFIELD))
MESH = wp.constant(int(mujoco.mjtGeom.mjGEOM_MESH))
CCD_OVERFLOW = wp.constant(int(mjw.OverflowType.CCD))
HFIELD_OVERFLOW = wp.constant(int(mjw.OverflowType.HFIELD))
FAR = wp.constant(float(mujoco.mjMAXVAL))
MOST = wp.constant(int(mujoco.mjMAXCONPAIR))
"""Prisms that a geom may touch; further ones are not looked at."""
DISTINCT = wp.constant(1e-3)
"""Distance below which a further contact adds nothing [m]."""
CLEAR = wp.constant(1e-4)
"""Distance from a prism's top that no rounding turns into a contact [m]."""


@wp.struct
class Scene:
  """Arrays that the kernels read, named as in MuJoCo Warp's `Model` and `Data`."""

  ccd_tolerance: wp.array[float]
  geom_type: wp.array[int]
  geom_condim: wp.array[int]
  geom_dataid: wp.array2d[int]
  geom_priority: wp.array[int]
  geom_solmix: wp.array2d[float]
  geom_solref: wp.array2d[wp.vec2]
  geom_solimp: wp.array2d[_vec5]
  geom_size: wp.array2d[wp.vec3]
  geom_rbound: wp.array2d[float]
  geom_friction: wp.array2d[wp.vec3]
  geom_margin: wp.array2d[float]
  geom_gap: wp.array2d[float]
  geom_adhesion: wp.array2d[float]
  mesh_vertadr: wp.array[int]
  mesh_vertnum: wp.array[int]
  mesh_graphadr: wp.array[int]
  mesh_vert: wp.array[wp.vec3]
  mesh_graph: wp.array[int]
  mesh_polynum: wp.array[int]
  mesh_polyadr: wp.array[int]
  mesh_polynormal: wp.array[wp.vec3]
  mesh_polyvertadr: wp.array[int]
  mesh_polyvertnum: wp.array[int]
  mesh_polyvert: wp.array[int]
  mesh_polymapadr: wp.array[int]
  mesh_polymapnum: wp.array[int]
  mesh_polymap: wp.array[int]
  hfield_size: wp.array[wp.vec4]
  hfield_nrow: wp.array[int]
  hfield_ncol: wp.array[int]
  hfield_adr: wp.array[int]
  hfield_data: wp.array[float]
  pair_dim: wp.array[int]
  pair_solref: wp.array2d[wp.vec2]
  pair_solreffriction: wp.array2d[wp.vec2]
  pair_solimp: wp.array2d[_vec5]
  pair_margin: wp.array2d[float]
  pair_gap: wp.array2d[float]
  pair_adhesion: wp.array2d[float]
  pair_friction: wp.array2d[_vec5]
  geom_xpos: wp.array2d[wp.vec3]
  geom_xmat: wp.array2d[wp.mat33]
  ncollision: wp.array[int]
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
class Written:
  """Arrays that contacts are written to, named as in MuJoCo Warp's `Data`."""

  naconmax: int
  contact_dist: wp.array[float]
  contact_pos: wp.array[wp.vec3]
  contact_frame: wp.array[wp.mat33]
  contact_includemargin: wp.array[float]
  contact_friction: wp.array[_vec5]
  contact_solref: wp.array[wp.vec2]
  contact_solreffriction: wp.array[wp.vec2]
  contact_solimp: wp.array[_vec5]
  contact_dim: wp.array[int]
  contact_geom: wp.array[wp.vec2i]
  contact_efc_address: wp.array2d[int]
  contact_worldid: wp.array[int]
  contact_type: wp.array[int]
  contact_geomcollisionid: wp.array[int]
  contact_adhesion: wp.array[float]
  nacon: wp.array[int]


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
    for j in range(2):
      prism[i, j] = corner[j]
      prism[i + 3, j] = corner[j]
    prism[i, 2] = -s.hfield_size[field][3]
    prism[i + 3, 2] = corner[2] + margin
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
def _margin_gap(s: Scene, geoms: wp.vec2i, pair: int, world: int):
  pairid = s.collision_pairid[pair][0]
  return internals.contact_margin_gap(s.geom_margin, s.geom_gap, s.pair_margin, s.pair_gap, geoms, pairid, world)


@wp.func
def _is_clear(prism: _mat63, geom: Any, kind: int, clear: float):
  """Return True if a geom is above the plane of a prism's top, by more than `clear`."""
  a = wp.vec3(prism[3, 0], prism[3, 1], prism[3, 2])
  b = wp.vec3(prism[4, 0], prism[4, 1], prism[4, 2])
  c = wp.vec3(prism[5, 0], prism[5, 1], prism[5, 2])
  normal = wp.normalize(wp.cross(b - a, c - a))
  if normal[2] < 0.0:
    normal = -normal
  lowest = internals.support(geom, kind, -normal)
  return wp.dot(lowest.point - a, normal) > clear


@wp.func
def _may_touch(prism: _mat63, geom: Any, kind: int, lowest: float, clear: float):
  if prism[3, 2] < lowest and prism[4, 2] < lowest and prism[5, 2] < lowest:
    return False
  # The support of a mesh is a search, as dear as the collision of a prism that is clear.
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
  margin, gap = _margin_gap(s, geoms, pair, world)
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
      margin, gap = _margin_gap(s, geoms, pair, world)
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


@wp.kernel(enable_backward=False)
def choose_contacts(s: Scene, prisms: Prisms, d: Written, overflow: wp.array[int]):
  """Write up to four contacts of each pair: the deepest, and those that span most ground with it."""
  pair = wp.tid()
  if pair >= s.ncollision[0] or prisms.number[pair] == 0:
    return
  geoms, world = s.collision_pair[pair], s.collision_worldid[pair]
  first = prisms.first[pair]
  end = first + prisms.number[pair]
  touching = wp.int32(0)
  chosen = wp.vec4i(-1, -1, -1, -1)
  least = wp.float32(FAR)
  for i in range(first, end):
    if touching == MOST:
      wp.atomic_or(overflow, world, HFIELD_OVERFLOW)
      end = i
      break
    if prisms.dist[i] < FAR:
      touching += 1
      if prisms.dist[i] < least:
        least = prisms.dist[i]
        chosen[0] = i
  if touching == 0:
    return

  margin, gap = _margin_gap(s, geoms, pair, world)
  _geoms_again, _margin, _gap, condim, friction, solref, solreffriction, solimp, adhesion = internals.contact_params(
    s.geom_condim,
    s.geom_priority,
    s.geom_solmix,
    s.geom_solref,
    s.geom_solimp,
    s.geom_friction,
    s.geom_margin,
    s.geom_gap,
    s.geom_adhesion,
    s.pair_dim,
    s.pair_solref,
    s.pair_solreffriction,
    s.pair_solimp,
    s.pair_margin,
    s.pair_gap,
    s.pair_adhesion,
    s.pair_friction,
    s.collision_pair,
    s.collision_pairid,
    pair,
    world,
  )
  origin, up = prisms.pos[chosen[0]], prisms.normal[chosen[0]]
  other = wp.vec3()
  across = wp.vec3()
  along = wp.vec3()
  for k in range(4):
    if k > 0:
      best = wp.int32(-1)
      most = wp.float32(-FAR)
      for i in range(first, end):
        if prisms.dist[i] < FAR and i != chosen[0] and i != chosen[1] and i != chosen[2]:
          arm = prisms.pos[i] - origin
          score = wp.length(arm)
          if k == 2:
            score = wp.abs(wp.dot(arm, across))
          elif k == 3:
            score = wp.abs(wp.dot(arm, across)) + wp.abs(wp.dot(other - prisms.pos[i], along))
          if score > most:
            best = i
            most = score
      if best == -1 or (most > 0.0 and most < DISTINCT):
        return
      chosen[k] = best
      if k == 1:
        other = prisms.pos[best]
        across = wp.cross(up, origin - other)
      elif k == 2:
        across = wp.cross(up, origin - prisms.pos[best])
        along = wp.cross(up, other - prisms.pos[best])
    contact = chosen[k]
    internals.write_contact(
      d.naconmax,
      k,
      prisms.dist[contact],
      prisms.pos[contact],
      internals.make_frame(prisms.normal[contact]),
      margin,
      gap,
      condim,
      friction,
      solref,
      solreffriction,
      solimp,
      adhesion,
      geoms,
      s.collision_pairid[pair],
      world,
      d.contact_dist,
      d.contact_pos,
      d.contact_frame,
      d.contact_includemargin,
      d.contact_friction,
      d.contact_solref,
      d.contact_solreffriction,
      d.contact_solimp,
      d.contact_dim,
      d.contact_geom,
      d.contact_efc_address,
      d.contact_worldid,
      d.contact_type,
      d.contact_geomcollisionid,
      d.contact_adhesion,
      d.nacon,
    )
