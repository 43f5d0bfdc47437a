"""Kernel of `HeightFields` that chooses contacts among the prisms that a geom touches."""

import mujoco
import mujoco_warp as mjw
import warp as wp

from mjlab_sim.warp import internals
from mjlab_sim.warp.collision.height_field_kernels import FAR, Prisms, Scene
from mjlab_sim.warp.structs import with_arrays

HFIELD_OVERFLOW = wp.constant(int(mjw.OverflowType.HFIELD))
MOST = wp.constant(int(mujoco.mjMAXCONPAIR))
"""Prisms that a geom may touch; further ones are not looked at."""
DISTINCT = wp.constant(1e-3)
"""Distance below which a further contact adds nothing [m]."""


@with_arrays(
  """naconmax contact_dist contact_pos contact_frame contact_includemargin contact_friction contact_solref
  contact_solreffriction contact_solimp contact_dim contact_geom contact_efc_address contact_worldid contact_type
  contact_geomcollisionid contact_adhesion nacon"""
)
class Written:
  """Arrays that contacts are written to."""


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

  _geoms_again, margin, gap, condim, friction, solref, solreffriction, solimp, adhesion = internals.contact_params(
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
