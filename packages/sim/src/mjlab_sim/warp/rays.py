"""Rays on a GPU: a tree of triangles for geoms that never move, and all other geoms one by one."""

import itertools
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from mjlab_core import MjlabError
from numpy.typing import NDArray

from mjlab_sim.rays import Geoms, Rays, RayTargets, asset_surface, triangulate
from mjlab_sim.warp import engine_kernels as kernels
from mjlab_sim.warp import internals
from mjlab_sim.warp.launching import Stage
from mjlab_sim.warp.structs import filled

_FLAT_FACES = (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD)


class RayScene:
  """Trees of the geoms that the casters of one simulation see.

  Args:
    stage: Geoms and their poses in every world.
  """

  def __init__(self, stage: Stage) -> None:
    self.stage = stage
    self._fixed: dict[bytes, tuple[wp.Mesh | None, Any]] = {}
    self._surfaces: dict[int, list[wp.Mesh]] = {}

  def triangles(self, geoms: Geoms) -> tuple[wp.Mesh | None, Any]:
    """Return fixed geoms as one tree that all worlds share, None without any, and the geom of each triangle.

    It is built once for the casters that see the same geoms.
    """
    key = geoms.tobytes()
    if not len(geoms):
      return None, wp.zeros(0, dtype=wp.int32)
    if key not in self._fixed:
      surface, owners = triangulate(self.stage.model, geoms)
      self._fixed[key] = _tree(*surface), wp.array(owners, dtype=wp.int32)
    return self._fixed[key]

  def surfaces(self, kind: int, count: int, geoms: Geoms) -> Any:
    """Return handles of all meshes or height fields, each a tree in its geoms' own frame, (count,).

    They are for geoms that move, or that were moved. A geom may have another mesh in some worlds, so rays that see one
    geom of a kind need all surfaces of the kind; handles are zero if no geom in `geoms` is of the kind.
    """
    if not (self.stage.model.geom_type[geoms] == kind).any():
      return wp.zeros(count, dtype=wp.uint64)
    if kind not in self._surfaces:
      self._surfaces[kind] = [_tree(*asset_surface(self.stage.model, kind, number)) for number in range(count)]
    return wp.array([tree.id for tree in self._surfaces[kind]], dtype=wp.uint64)


def _tree(vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> wp.Mesh:
  # Built on the host, once; rays search it faster than the tree that Warp builds on a GPU.
  points, indices = wp.array(vertices, dtype=wp.vec3), wp.array(triangles.ravel(), dtype=wp.int32)
  return wp.Mesh(points, indices, bvh_constructor="sah", bvh_leaf_size=1)


class WarpRayCaster:
  """One kernel over all rays of all worlds.

  Where one of the fixed geoms is not where the compiled model has it, all geoms are searched one by one.
  """

  # Graphs are kept by name, and a caster may be gone before its graph.
  _numbers = itertools.count()

  def __init__(self, scene: RayScene, targets: RayTargets, rays: Rays) -> None:
    self._stage, self._targets, self._rays = scene.stage, targets, rays
    self._name = f"rays {next(self._numbers)}"
    if not internals.IS_TESTED and (targets.exclude != targets.bodyexclude).any():
      raise MjlabError(
        f"exclude_trees needs mujoco-warp {internals.TESTED}, {mjw.__version__} is installed; exclude single bodies"
      )
    model, hits = scene.stage.model, rays.hits
    is_flat = np.isin(model.geom_type[targets.ground], _FLAT_FACES)
    every = np.concatenate((targets.ground, targets.others))
    with wp.ScopedDevice(self._stage.device):
      self._fixed, triangle_geom = scene.triangles(targets.ground[is_flat])
      self._others: Any = wp.array(np.concatenate((targets.ground[~is_flat], targets.others)), dtype=wp.int32)
      self._every: Any = wp.array(every, dtype=wp.int32)
      self._bodyexclude: Any = wp.array(targets.bodyexclude, dtype=wp.int32)
      self._arrays: dict[str, Any] = {
        "triangle_geom": triangle_geom,
        "mesh_surface": scene.surfaces(mujoco.mjtGeom.mjGEOM_MESH, model.nmesh, every),
        "hfield_surface": scene.surfaces(mujoco.mjtGeom.mjGEOM_HFIELD, model.nhfield, every),
        "owner": wp.array(targets.owner, dtype=wp.int32),
        "exclude": wp.array(targets.exclude, dtype=wp.int32),
        # Python's infinity would make Warp's comparisons with a miss ambiguous.
        "max_distance": min(targets.max_distance, mujoco.mjMAXVAL),
        "origins": wp.from_torch(rays.origins, dtype=wp.vec3),
        "directions": wp.from_torch(rays.directions, dtype=wp.vec3),
        "distance": wp.from_torch(hits.distance),
        "geomid": wp.empty(hits.distance.shape, int) if hits.geomid is None else wp.from_torch(hits.geomid),
        "normal": wp.from_torch(hits.normal, dtype=wp.vec3),
      }

  def cast(self, is_in_place: bool) -> None:
    """Fill the hits; `is_in_place` is True if the fixed geoms are in their compiled places."""
    if not internals.IS_TESTED:
      self._stage.run(f"{self._name} public", self._search_public)
      self._rays.drop_far_hits(self._targets.max_distance)
    elif is_in_place:
      self._stage.run(self._name, lambda: self._search(self._fixed, self._others))
    else:
      self._stage.run(f"{self._name} one by one", lambda: self._search(None, self._every))

  def _search_public(self) -> None:
    groups: Any = [float(seen) for seen in self._targets.geomgroup or [-1] * mujoco.mjNGROUP]
    origins, directions, distance, geomid, normal = (
      self._arrays[name] for name in ("origins", "directions", "distance", "geomid", "normal")
    )
    mjw.rays(
      self._stage.m, self._stage.d, origins, directions, groups, True, self._bodyexclude, distance, geomid, normal
    )

  def _search(self, fixed: wp.Mesh | None, others: Any) -> None:
    mesh = wp.uint64(0 if fixed is None else fixed.id)
    rays = filled(kernels.Rays, self._stage.m, self._stage.d, mesh=mesh, others=others, **self._arrays)
    wp.launch(kernels.cast_rays, dim=rays.origins.shape, inputs=[rays])
