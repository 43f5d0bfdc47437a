"""Rays on a CPU: MuJoCo's own, and fewer geoms for them to search."""

import functools

import mujoco
import numpy as np
import torch
from mujoco import batch
from numpy.typing import NDArray

from mjlab_sim.rays import Rays, RayTargets, heights_of, triangulate

# A ray takes as long for one mesh of any size as for about so many boxes, one after another.
_MANY = 32
# How far behind a surface that a ray passes through it goes on [m].
_SKIN = 1e-6
_Geom = mujoco.mjtGeom


class NativeRayCaster:
  """`mj_ray` in every world, on all cores.

  Args:
    worlds: All geoms of all worlds.
    targets: Geoms that rays can hit.
    rays: Rays and their hits.
    ground: Fixed geoms by themselves, in as many worlds (`ground_model`); None casts against all geoms alike, and hits
      then have a geom.
  """

  def __init__(self, worlds: batch.Batch, targets: RayTargets, rays: Rays, ground: batch.Batch | None) -> None:
    self._worlds, self._targets, self._rays, self._ground = worlds, targets, rays, ground
    self._groups = None if targets.geomgroup is None else np.array(targets.geomgroup, dtype=np.uint8)

  def cast(self, is_in_place: bool) -> None:
    """Fill the hits; `is_in_place` is True if the fixed geoms are in their compiled places."""
    rays = self._rays.origins.numpy(), self._rays.directions.numpy()
    if self._ground is None or not is_in_place:
      distance, geomid, normal = self._against_all(*rays, flg_static=True)
    else:
      distance, geomid, normal = self._ground.ray(*rays, normal=True)
      if len(self._targets.others):
        moving, _, moving_normal = self._against_all(*rays, flg_static=False)
        nearer = (moving >= 0.0) & ((moving < distance) | (distance < 0.0))
        distance = np.where(nearer, moving, distance)
        normal = np.where(nearer[..., None], moving_normal, normal)
    hits = self._rays.hits
    hits.distance.copy_(torch.from_numpy(distance))
    hits.normal.copy_(torch.from_numpy(normal))
    if hits.geomid is not None:
      hits.geomid.copy_(torch.from_numpy(geomid))
    if self._targets.max_distance < np.inf:
      self._rays.drop_far_hits(self._targets.max_distance)

  def _against_all(
    self, origins: NDArray[np.float64], directions: NDArray[np.float64], *, flg_static: bool
  ) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
    cast = functools.partial(
      self._worlds.ray,
      geomgroup=self._groups,
      flg_static=flg_static,
      bodyexclude=self._targets.bodyexclude,
      normal=True,
    )
    distance, geomid, normal = cast(origins, directions)
    # MuJoCo's rays pass through one body. To pass through more, those that hit them go on behind what they hit.
    own = self._hits_own(geomid)
    while own.any():
      worlds = np.flatnonzero(own.any(axis=1))
      passed = np.where(own, distance + _SKIN, 0.0)[worlds]
      start = origins[worlds] + passed[..., None] * directions[worlds]
      further, geom, surface = cast(start, directions[worlds], ids=worlds)
      again = own[worlds]
      distance[worlds] = np.where(again, np.where(further < 0.0, -1.0, passed + further), distance[worlds])
      geomid[worlds] = np.where(again, geom, geomid[worlds])
      normal[worlds] = np.where(again[..., None], surface, normal[worlds])
      own &= self._hits_own(geomid)
    return distance, geomid, normal

  def _hits_own(self, geomid: NDArray[np.int32]) -> NDArray[np.bool_]:
    return (geomid >= 0) & (self._targets.owner[geomid] == self._targets.exclude)


def ground_model(model: mujoco.MjModel, targets: RayTargets) -> mujoco.MjModel | None:
  """Return a model of the ground in which boxes and meshes are one mesh; None if rays would gain nothing from it.

  They gain from a tree instead of many geoms, and from not meeting the bodies that they pass through one by one.
  MuJoCo looks up the triangles of a mesh in a tree. Its vertices have single precision. Height fields stay as they
  are: as triangles they would take a gigabyte.
  """
  ground, rest = targets.ground, targets.others
  merged = ground[np.isin(model.geom_type[ground], (_Geom.mjGEOM_BOX, _Geom.mjGEOM_MESH))]
  # MuJoCo finds moving geoms by their weld: a geom that is neither ground nor moving would be lost.
  passed = np.isin(targets.owner, targets.exclude) & ~np.isin(model.geom_bodyid, targets.bodyexclude)
  gains = len(merged) >= _MANY or passed.any()
  if not (gains and len(ground)) or (model.body_weldid[model.geom_bodyid[rest]] == 0).any():
    return None
  spec = mujoco.MjSpec()
  if len(merged):
    (vertices, triangles), _ = triangulate(model, merged)
    mesh = spec.add_mesh(name="merged", uservert=vertices.ravel(), userface=triangles.ravel())
    # The soup need not be closed.
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    # Without collisions it needs no convex hull.
    spec.worldbody.add_geom(type=_Geom.mjGEOM_MESH, meshname="merged", contype=0, conaffinity=0)
  data = mujoco.MjData(model)
  mujoco.mj_kinematics(model, data)
  fields = []
  for geom in np.setdiff1d(ground, merged):
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, data.geom_xmat[geom])
    alone = spec.worldbody.add_geom(
      type=_Geom(model.geom_type[geom]), pos=data.geom_xpos[geom], quat=quat, contype=0, conaffinity=0
    )
    if model.geom_type[geom] == _Geom.mjGEOM_HFIELD:
      field = model.geom_dataid[geom]
      heights = heights_of(model, field)
      rows, columns = heights.shape
      alone.hfieldname = f"field{geom}"
      size = model.hfield_size[field]
      spec.add_hfield(name=alone.hfieldname, nrow=rows, ncol=columns, size=size, userdata=heights.ravel())
      fields.append(heights.ravel())
    else:
      alone.size = model.geom_size[geom]
  compiled = spec.compile()
  # The compiler stretches heights to fill the range from 0 to 1.
  compiled.hfield_data[:] = np.concatenate([np.zeros(0), *fields])
  return compiled
