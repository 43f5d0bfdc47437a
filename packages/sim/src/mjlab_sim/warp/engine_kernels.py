"""Warp kernels that MuJoCo Warp does not have."""

import mujoco_warp as mjw
import warp as wp

from mjlab_sim.warp.internals import compute_ray, ray_geom

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
def clear_worlds(mask: wp.array[bool], rows: wp.array2d[float]):
  """Zero the rows of masked worlds."""
  world, column = wp.tid()
  if mask[world]:
    rows[world, column] = 0.0


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


# A module of its own, compiled when the first ray caster is made.
@wp.kernel(enable_backward=False, module="unique")
def cast_rays(
  mesh: wp.uint64,
  triangle_geom: wp.array[int],
  others: wp.array[int],
  geom_type: wp.array[int],
  geom_dataid: wp.array2d[int],
  geom_size: wp.array2d[wp.vec3],
  geom_xpos: wp.array2d[wp.vec3],
  geom_xmat: wp.array2d[wp.mat33],
  mesh_surface: wp.array[wp.uint64],
  hfield_surface: wp.array[wp.uint64],
  owner: wp.array[int],
  exclude: wp.array[int],
  max_distance: float,
  origins: wp.array2d[wp.vec3],
  directions: wp.array2d[wp.vec3],
  distance: wp.array2d[float],
  geomid: wp.array2d[int],
  normal: wp.array2d[wp.vec3],
):
  """Find the nearest hit of each ray on the triangles of fixed geoms (`mesh`, 0 for none) and on `others`, one by one.

  Rays pass through geoms whose `owner` they `exclude`. Meshes and height fields are surfaces in their geom's frame.
  """
  world, ray = wp.tid()
  origin = origins[world, ray]
  direction = directions[world, ray]
  nearest = max_distance
  hit_geom = -1
  hit_normal = wp.vec3()
  if mesh != wp.uint64(0):
    query = wp.mesh_query_ray(mesh, origin, direction, nearest)
    if query.result:
      nearest = query.t
      hit_geom = triangle_geom[query.face]
      hit_normal = query.normal
  for i in range(others.shape[0]):
    geom = others[i]
    if owner[geom] != exclude[ray]:
      kind = geom_type[geom]
      position = geom_xpos[world, geom]
      rotation = geom_xmat[world, geom]
      if kind == MESH or kind == HFIELD:  # noqa: SIM109 - Warp has no "in"
        asset = geom_dataid[world % geom_dataid.shape[0], geom]
        surface = wp.uint64(0)
        if kind == MESH:
          surface = mesh_surface[asset]
        else:
          surface = hfield_surface[asset]
        unturned = wp.transpose(rotation)
        found = wp.mesh_query_ray(surface, unturned * (origin - position), unturned * direction, nearest)
        if found.result:
          nearest = found.t
          hit_geom = geom
          hit_normal = rotation * found.normal
      else:
        size = geom_size[world % geom_size.shape[0], geom]
        t, n = ray_geom(position, rotation, size, origin, direction, kind)
        if t >= 0.0 and t <= nearest:
          nearest = t
          hit_geom = geom
          hit_normal = n
  distance[world, ray] = wp.where(hit_geom < 0, -1.0, nearest)
  geomid[world, ray] = hit_geom
  normal[world, ray] = hit_normal


@wp.kernel(enable_backward=False, module="unique")
def drop_far_hits(
  max_distance: float, distance: wp.array2d[float], geomid: wp.array2d[int], normal: wp.array2d[wp.vec3]
):
  """Make misses of the hits beyond `max_distance`."""
  world, ray = wp.tid()
  if distance[world, ray] > max_distance:
    distance[world, ray] = -1.0
    geomid[world, ray] = -1
    normal[world, ray] = wp.vec3()


@wp.kernel(enable_backward=False, module="unique")
def unpack_images(
  is_due: wp.array[bool],
  packed_rgb: wp.array2d[wp.uint32],
  planar_depth: wp.array2d[float],
  seen_object: wp.array2d[wp.vec2i],
  rgb_adr: wp.array[int],
  depth_adr: wp.array[int],
  seg_adr: wp.array[int],
  cam_projection: wp.array[int],
  cam_fovy: wp.array2d[float],
  cam_sensorsize: wp.array[wp.vec2],
  cam_intrinsic: wp.array2d[wp.vec4],
  camera: int,
  width: int,
  height: int,
  znear: float,
  rgb: wp.array3d[wp.uint8],
  depth: wp.array3d[float],
  distance: wp.array3d[float],
  segmentation: wp.array3d[int],
):
  """Write the images of the worlds that are due, channels first; images that are not drawn have no pixels."""
  world, pixel = wp.tid()
  if not is_due[world]:
    return
  if rgb.shape[2] > 0:
    color = packed_rgb[world, rgb_adr[0] + pixel]
    for channel in range(3):
      rgb[world, channel, pixel] = wp.uint8((color >> wp.uint32(16 - 8 * channel)) & wp.uint32(0xFF))
  if depth.shape[2] > 0 or distance.shape[2] > 0:
    planar = planar_depth[world, depth_adr[0] + pixel]
    along = planar
    if planar <= 0.0:
      planar = -1.0
      along = -1.0
    elif distance.shape[2] > 0:
      ray, _offset = compute_ray(
        cam_projection[camera],
        cam_fovy[world % cam_fovy.shape[0], camera],
        cam_sensorsize[camera],
        cam_intrinsic[world % cam_intrinsic.shape[0], camera],
        width,
        height,
        pixel % width,
        pixel // width,
        znear,
      )
      along = -planar / ray[2]
    if depth.shape[2] > 0:
      depth[world, 0, pixel] = planar
    if distance.shape[2] > 0:
      distance[world, 0, pixel] = along
  if segmentation.shape[2] > 0:
    seen = seen_object[world, seg_adr[0] + pixel]
    segmentation[world, 0, pixel] = seen[0]
    segmentation[world, 1, pixel] = seen[1]
