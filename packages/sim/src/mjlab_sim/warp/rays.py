"""Rays on a GPU: a tree of triangles for what never moves, and all other geoms one by one."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from mjlab_core import MjlabError
from numpy.typing import NDArray

from mjlab_sim.rays import EngineRays, Geoms, Mesh, RayHits, RayTargets, hfield_surface, mesh_surface, triangulate
from mjlab_sim.warp import engine_kernels as kernels
from mjlab_sim.warp import internals
from mjlab_sim.warp.launching import Stage


@dataclass
class RayScene(Stage):
  """Geoms of a model and their poses in every world, for rays."""

  def __post_init__(self) -> None:
    self._numbers = itertools.count()
    self._fixed: dict[bytes, tuple[wp.Mesh | None, Any]] = {}
    self._surfaces: dict[int, tuple[list[wp.Mesh], Any]] = {}

  def caster(self, targets: RayTargets, max_distance: float, *, geomid: bool) -> EngineRays:
    """Return rays that see `targets` up to `max_distance` [m]."""
    # Graphs are kept by name, and a caster may be gone before its graph.
    return WarpRayCaster(self, f"rays {next(self._numbers)}", targets, max_distance).rays(geomid=geomid)

  def triangles(self, geoms: Geoms) -> tuple[wp.Mesh | None, Any]:
    """Return fixed geoms as one tree that all worlds share, None without any, and the geom of each triangle.

    It is built once for the casters that see the same geoms.
    """
    key = geoms.tobytes()
    if key not in self._fixed:
      surface, owners = triangulate(self.model, geoms)
      self._fixed[key] = _tree(*surface) if len(geoms) else None, wp.array(owners, dtype=wp.int32)
    return self._fixed[key]

  def surfaces(self, kind: int, count: int, surface_of: Callable[[mujoco.MjModel, int], Mesh], geoms: Geoms) -> Any:
    """Return handles of all meshes or height fields, each a tree in its geoms' own frame, (count,).

    They are for geoms that move, or that were moved. A geom may have another mesh in some worlds, so rays that see one
    geom of a kind need all surfaces of the kind; handles are zero if no geom in `geoms` is of the kind.
    """
    if not (self.model.geom_type[geoms] == kind).any():
      return wp.zeros(count, dtype=wp.uint64)
    if kind not in self._surfaces:
      trees = [_tree(*surface_of(self.model, number)) for number in range(count)]
      self._surfaces[kind] = trees, wp.array([tree.id for tree in trees], dtype=wp.uint64)
    return self._surfaces[kind][1]

  def clear(self) -> None:
    """Release the trees."""
    self._fixed.clear()
    self._surfaces.clear()


def _tree(vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> wp.Mesh:
  # Built on the host, once; rays search it faster than the tree that Warp builds on a GPU.
  points, indices = wp.array(vertices, dtype=wp.vec3), wp.array(triangles.ravel(), dtype=wp.int32)
  return wp.Mesh(points, indices, bvh_constructor="sah", bvh_leaf_size=1)


class WarpRayCaster:
  """One kernel over all rays of all worlds.

  Where one of the fixed geoms is not where the compiled model has it, all geoms are searched one by one.
  """

  def __init__(self, scene: RayScene, name: str, targets: RayTargets, max_distance: float) -> None:
    self._scene, self._name = scene, name
    model, num_envs, num_rays = scene.model, scene.num_envs, len(targets.exclude)
    # Python's infinity would make Warp's comparisons with a miss ambiguous.
    self._max_distance = min(max_distance, mujoco.mjMAXVAL)
    if not internals.IS_TESTED and (targets.exclude != targets.bodyexclude).any():
      raise MjlabError(
        f"exclude_trees needs mujoco-warp {internals.TESTED}, {mjw.__version__} is installed; exclude single bodies"
      )
    groups = targets.geomgroup
    self._groups: Any = [-1.0] * 6 if groups is None else [float(group) for group in groups]
    with wp.ScopedDevice(scene.device):
      self._fixed, self._fixed_geom = scene.triangles(targets.fixed)
      every = np.concatenate((targets.fixed, targets.others))
      self._meshes = scene.surfaces(mujoco.mjtGeom.mjGEOM_MESH, model.nmesh, mesh_surface, every)
      self._hfields = scene.surfaces(mujoco.mjtGeom.mjGEOM_HFIELD, model.nhfield, hfield_surface, every)
      self._others: Any = wp.array(targets.others, dtype=wp.int32)
      self._every: Any = wp.array(every, dtype=wp.int32)
      self._owner: Any = wp.array(targets.owner, dtype=wp.int32)
      self._exclude: Any = wp.array(targets.exclude, dtype=wp.int32)
      self._bodyexclude: Any = wp.array(targets.bodyexclude, dtype=wp.int32)
      self._origins: Any = wp.zeros((num_envs, num_rays), dtype=wp.vec3)
      self._directions: Any = wp.zeros((num_envs, num_rays), dtype=wp.vec3)
      self._distance: Any = wp.full((num_envs, num_rays), -1.0, dtype=wp.float32)
      self._geomid: Any = wp.full((num_envs, num_rays), -1, dtype=wp.int32)
      self._normal: Any = wp.zeros((num_envs, num_rays), dtype=wp.vec3)

  def rays(self, *, geomid: bool) -> EngineRays:
    """Return the memory of the caster, and its function."""
    return EngineRays(
      origins=wp.to_torch(self._origins),
      directions=wp.to_torch(self._directions),
      hits=RayHits(
        distance=wp.to_torch(self._distance),
        geomid=wp.to_torch(self._geomid) if geomid else None,
        normal=wp.to_torch(self._normal),
      ),
      cast=self._cast,
    )

  def _cast(self, is_in_place: bool) -> None:
    if not internals.IS_TESTED:
      self._scene.run(f"{self._name} public", self._search_public)
    elif is_in_place:
      self._scene.run(self._name, lambda: self._search(self._fixed, self._others))
    else:
      self._scene.run(f"{self._name} one by one", lambda: self._search(None, self._every))

  def _search_public(self) -> None:
    scene = self._scene
    outputs = [self._distance, self._geomid, self._normal]
    mjw.rays(scene.m, scene.d, self._origins, self._directions, self._groups, True, self._bodyexclude, *outputs)
    wp.launch(kernels.drop_far_hits, dim=self._distance.shape, inputs=[self._max_distance, *outputs])

  def _search(self, fixed: wp.Mesh | None, others: Any) -> None:
    m, d = self._scene.m, self._scene.d
    wp.launch(
      kernels.cast_rays,
      dim=self._distance.shape,
      inputs=[
        wp.uint64(0 if fixed is None else fixed.id),
        *(self._fixed_geom, others),
        *(m.geom_type, m.geom_dataid, m.geom_size, d.geom_xpos, d.geom_xmat),
        *(self._meshes, self._hfields, self._owner, self._exclude, self._max_distance),
        *(self._origins, self._directions),
      ],
      outputs=[self._distance, self._geomid, self._normal],
      device=self._scene.device,
    )
