"""Warp kernels that MuJoCo Warp does not have."""

import mujoco_warp as mjw
import warp as wp

from mjlab_sim.warp.internals import compute_ray, ray_geom
from mjlab_sim.warp.structs import with_arrays

MESH = wp.constant(int(mjw.GeomType.MESH))
HFIELD = wp.constant(int(mjw.GeomType.HFIELD))


@wp.kernel(enable_backward=False)
def restore_acceleration_sensors(
  saved: wp.array2d[float], is_acceleration: wp.array[bool], sensordata: wp.array2d[float]
):
  """Copy the readings of the acceleration stage back."""
  world, column = wp.tid()
  if is_acceleration[column]:
    sensordata[world, column] = saved[world, column]


@wp.kernel(enable_backward=False)
def count_overflow(
  overflow: wp.array[int],
  nefc: wp.array[int],
  nacon: wp.array[int],
  ncollision: wp.array[int],
  seen: wp.array[int],
  most: wp.array[int],
):
  """Move each world's sticky bits into `seen`; keep the largest (rows of a world, contacts, pairs) in `most`."""
  world = wp.tid()
  seen[world] = seen[world] | overflow[world]
  overflow[world] = 0
  # A stale read only costs an atomic that changes nothing.
  if nefc[world] > most[0]:
    wp.atomic_max(most, 0, nefc[world])
  if world == 0:
    most[1] = wp.max(most[1], nacon[0])
    most[2] = wp.max(most[2], ncollision[0])


@with_arrays("geom_type geom_dataid geom_size geom_xpos geom_xmat")
class Rays:
  """Rays of one caster."""

  mesh: wp.uint64
  """Triangles of fixed geoms in the world, 0 for none."""
  triangle_geom: wp.array[int]
  others: wp.array[int]
  """Geoms that are searched one by one."""
  mesh_surface: wp.array[wp.uint64]
  """Triangles of each mesh in the frame of its geoms."""
  hfield_surface: wp.array[wp.uint64]
  owner: wp.array[int]
  """Owner of each geom."""
  exclude: wp.array[int]
  """Owner whose geoms each ray passes through."""
  max_distance: float
  origins: wp.array2d[wp.vec3]
  directions: wp.array2d[wp.vec3]
  distance: wp.array2d[float]
  geomid: wp.array2d[int]
  normal: wp.array2d[wp.vec3]


# A separate module, compiled when the first ray caster is made.
@wp.kernel(enable_backward=False, module="unique")
def cast_rays(r: Rays):
  """Find the nearest hit of each ray on the triangles of fixed geoms and on `others`, one by one."""
  world, ray = wp.tid()
  origin = r.origins[world, ray]
  direction = r.directions[world, ray]
  nearest = r.max_distance
  hit_geom = -1
  hit_normal = wp.vec3()
  if r.mesh != wp.uint64(0):
    query = wp.mesh_query_ray(r.mesh, origin, direction, nearest)
    if query.result:
      nearest = query.t
      hit_geom = r.triangle_geom[query.face]
      hit_normal = query.normal
  for i in range(r.others.shape[0]):
    geom = r.others[i]
    if r.owner[geom] != r.exclude[ray]:
      kind = r.geom_type[geom]
      position = r.geom_xpos[world, geom]
      rotation = r.geom_xmat[world, geom]
      if kind == MESH or kind == HFIELD:  # noqa: SIM109 - Warp has no "in"
        asset = r.geom_dataid[world % r.geom_dataid.shape[0], geom]
        surface = wp.uint64(0)
        if kind == MESH:
          surface = r.mesh_surface[asset]
        else:
          surface = r.hfield_surface[asset]
        unturned = wp.transpose(rotation)
        found = wp.mesh_query_ray(surface, unturned * (origin - position), unturned * direction, nearest)
        if found.result:
          nearest = found.t
          hit_geom = geom
          hit_normal = rotation * found.normal
      else:
        size = r.geom_size[world % r.geom_size.shape[0], geom]
        t, n = ray_geom(position, rotation, size, origin, direction, kind)
        if t >= 0.0 and t <= nearest:
          nearest = t
          hit_geom = geom
          hit_normal = n
  r.distance[world, ray] = wp.where(hit_geom < 0, -1.0, nearest)
  r.geomid[world, ray] = hit_geom
  r.normal[world, ray] = hit_normal


@with_arrays("cam_projection cam_fovy cam_sensorsize cam_intrinsic")
class Pictures:
  """Images of one view in all worlds, and the render context that they are drawn in."""

  rgb_data: wp.array2d[wp.uint32]
  depth_data: wp.array2d[float]
  seg_data: wp.array2d[wp.vec2i]
  rgb_adr: wp.array[int]
  depth_adr: wp.array[int]
  seg_adr: wp.array[int]
  znear: float
  is_due: wp.array[bool]
  """Worlds whose images are written."""
  camera: int
  width: int
  height: int
  rgb: wp.array3d[wp.uint8]
  depth: wp.array3d[float]
  distance: wp.array3d[float]
  segmentation: wp.array3d[int]


@wp.kernel(enable_backward=False, module="unique")
def unpack_images(p: Pictures):
  """Write the images of the worlds that are due, channels first; images that are not drawn have no pixels."""
  world, pixel = wp.tid()
  if not p.is_due[world]:
    return
  if p.rgb.shape[2] > 0:
    color = p.rgb_data[world, p.rgb_adr[0] + pixel]
    for channel in range(3):
      p.rgb[world, channel, pixel] = wp.uint8((color >> wp.uint32(16 - 8 * channel)) & wp.uint32(0xFF))
  if p.depth.shape[2] > 0 or p.distance.shape[2] > 0:
    planar = p.depth_data[world, p.depth_adr[0] + pixel]
    along = planar
    if planar <= 0.0:
      planar = -1.0
      along = -1.0
    elif p.distance.shape[2] > 0:
      ray, _offset = compute_ray(
        p.cam_projection[p.camera],
        p.cam_fovy[world % p.cam_fovy.shape[0], p.camera],
        p.cam_sensorsize[p.camera],
        p.cam_intrinsic[world % p.cam_intrinsic.shape[0], p.camera],
        p.width,
        p.height,
        pixel % p.width,
        pixel // p.width,
        p.znear,
      )
      along = -planar / ray[2]
    if p.depth.shape[2] > 0:
      p.depth[world, 0, pixel] = planar
    if p.distance.shape[2] > 0:
      p.distance[world, 0, pixel] = along
  if p.segmentation.shape[2] > 0:
    seen = p.seg_data[world, p.seg_adr[0] + pixel]
    p.segmentation[world, 0, pixel] = seen[0]
    p.segmentation[world, 1, pixel] = seen[1]
