"""Rays on a GPU: a tree of triangles for what never moves, and all other geoms one by one."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import warp as wp
from mujoco_warp._src.types import MJ_MAXVAL
from numpy.typing import NDArray

from mjlab_sim import warp_kernels
from mjlab_sim.rays import RayHits
from mjlab_sim.static_rays import Geoms, Mesh, RayTargets, hfield_surface, mesh_surface, triangulate

if TYPE_CHECKING:
  from mjlab_sim.warp_engine import WarpEngine


class FixedTriangles:
  """Fixed geoms as one mesh that all worlds share."""

  def __init__(self, model: mujoco.MjModel, geoms: Geoms) -> None:
    (vertices, triangles), owners = triangulate(model, geoms)
    self.geom = wp.array(owners, dtype=wp.int32)
    self._mesh = _tree(vertices, triangles)
    self.id = wp.uint64(self._mesh.id)


class Surfaces:
  """Meshes and height fields of a model, each as a tree in its geoms' own frame.

  They are for geoms that move, or that should not but do. A geom may be given another one of its kind in some
  worlds, so that rays which see any of a kind need all.
  """

  def __init__(self, model: mujoco.MjModel) -> None:
    self._model = model
    self._meshes = _Trees(model.nmesh)
    self._hfields = _Trees(model.nhfield)

  def of(self, geoms: Geoms) -> tuple[Any, Any]:
    """Handles of all meshes (nmesh,) and of all height fields (nhfield,); zeros while no geom asked of that kind."""
    model = self._model
    kinds = set(model.geom_type[geoms].tolist())
    if mujoco.mjtGeom.mjGEOM_MESH in kinds:
      self._meshes.plant(lambda mesh: mesh_surface(model, mesh))
    if mujoco.mjtGeom.mjGEOM_HFIELD in kinds:
      self._hfields.plant(lambda hfield: hfield_surface(model, hfield))
    return self._meshes.handles, self._hfields.handles


class _Trees:
  def __init__(self, count: int) -> None:
    self.handles: Any = wp.zeros(count, dtype=wp.uint64)
    self._trees: list[wp.Mesh] = []

  def plant(self, surface_of: Callable[[int], Mesh]) -> None:
    if not self._trees:
      self._trees = [_tree(*surface_of(number)) for number in range(len(self.handles))]
      self.handles.assign(np.array([tree.id for tree in self._trees], dtype=np.uint64))


def _tree(vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> wp.Mesh:
  return wp.Mesh(wp.array(vertices, dtype=wp.vec3), wp.array(triangles.ravel(), dtype=wp.int32))


class WarpRayCaster:
  """One kernel over all rays of all worlds; the tree of fixed geoms is built once for the casters that see the same.

  Where one of these is not where the compiled model has it, all are searched one by one.
  """

  def __init__(self, engine: "WarpEngine", targets: RayTargets, max_distance: float, *, geomid: bool) -> None:
    self._engine = engine
    model, num_envs, num_rays = engine._mj_model, engine._num_envs, len(targets.exclude)
    # Graphs are kept by name, and a caster may be gone before its graph.
    self._name = f"rays {next(engine._caster_numbers)}"
    # Python's infinity would make Warp's comparisons with a miss ambiguous.
    self._max_distance = min(max_distance, MJ_MAXVAL)
    with wp.ScopedDevice(engine._wp_device):
      self._fixed: FixedTriangles | None = None
      if len(targets.fixed):
        key = targets.fixed.tobytes()
        if key not in engine._fixed_triangles:
          engine._fixed_triangles[key] = FixedTriangles(model, targets.fixed)
        self._fixed = engine._fixed_triangles[key]
      if engine._surfaces is None:
        engine._surfaces = Surfaces(model)
      every = np.concatenate((targets.fixed, targets.others))
      self._meshes, self._hfields = engine._surfaces.of(every)
      self._no_owner: Any = wp.zeros(0, dtype=wp.int32)
      self._others: Any = wp.array(targets.others, dtype=wp.int32)
      self._every: Any = wp.array(every, dtype=wp.int32)
      self._owner: Any = wp.array(targets.owner, dtype=wp.int32)
      self._exclude: Any = wp.array(targets.exclude, dtype=wp.int32)
      self._origins: Any = wp.zeros((num_envs, num_rays), dtype=wp.vec3)
      self._directions: Any = wp.zeros((num_envs, num_rays), dtype=wp.vec3)
      self._distance: Any = wp.full((num_envs, num_rays), -1.0, dtype=wp.float32)
      self._geomid: Any = wp.full((num_envs, num_rays), -1, dtype=wp.int32)
      self._normal: Any = wp.zeros((num_envs, num_rays), dtype=wp.vec3)
    self.origins = wp.to_torch(self._origins)
    self.directions = wp.to_torch(self._directions)
    self._hits = RayHits(
      distance=wp.to_torch(self._distance),
      geomid=wp.to_torch(self._geomid) if geomid else None,
      normal=wp.to_torch(self._normal),
    )

  def cast(self, *, fixed: bool) -> RayHits:
    if fixed or self._fixed is None:
      self._engine._run(self._name, self._search)
    else:
      self._engine._run(f"{self._name} one by one", self._search_one_by_one)
    return self._hits

  def _search(self) -> None:
    if self._fixed is None:
      self._launch(wp.uint64(0), self._no_owner, self._others)
    else:
      self._launch(self._fixed.id, self._fixed.geom, self._others)

  def _search_one_by_one(self) -> None:
    self._launch(wp.uint64(0), self._no_owner, self._every)

  def _launch(self, mesh: Any, triangle_geom: Any, others: Any) -> None:
    m, d = self._engine._m, self._engine._d
    wp.launch(
      warp_kernels.cast_rays,
      dim=self._distance.shape,
      inputs=[
        mesh,
        triangle_geom,
        others,
        m.geom_type,
        m.geom_dataid,
        m.geom_size,
        d.geom_xpos,
        d.geom_xmat,
        self._meshes,
        self._hfields,
        self._owner,
        self._exclude,
        self._max_distance,
        self._origins,
        self._directions,
      ],
      outputs=[self._distance, self._geomid, self._normal],
      device=self._engine._wp_device,
    )
