"""Rays on a GPU: a tree of triangles for what never moves, and all other geoms one by one."""

from typing import TYPE_CHECKING, Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from mujoco_warp._src.types import MJ_MAXVAL, vec6

from mjlab_sim import warp_kernels
from mjlab_sim.rays import RayHits
from mjlab_sim.static_rays import Geoms, RayTargets, triangulate

if TYPE_CHECKING:
  from mjlab_sim.warp_engine import WarpEngine

_MADE_OF_TRIANGLES = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD)


class FixedTriangles:
  """Fixed geoms as one mesh that all worlds share."""

  def __init__(self, model: mujoco.MjModel, geoms: Geoms) -> None:
    (vertices, triangles), owners = triangulate(model, geoms)
    self.geom = wp.array(owners, dtype=wp.int32)
    self._mesh = wp.Mesh(wp.array(vertices, dtype=wp.vec3), wp.array(triangles.ravel(), dtype=wp.int32))
    self.id = wp.uint64(self._mesh.id)


class WarpRayCaster:
  """One kernel over all rays of all worlds; the tree of fixed geoms is built once for the casters that see the same.

  MuJoCo Warp's own rays, which search every geom, are cast where a geom of triangles moves, or one that should not.
  """

  def __init__(self, engine: "WarpEngine", targets: RayTargets, max_distance: float, *, geomid: bool) -> None:
    self._engine = engine
    model, num_envs, num_rays = engine._mj_model, engine._num_envs, len(targets.bodyexclude)
    # Graphs are kept by name, and a caster may be gone before its graph.
    self._name = f"rays {next(engine._caster_numbers)}"
    # Python's infinity would make Warp's comparisons with a miss ambiguous.
    self._max_distance = min(max_distance, MJ_MAXVAL)
    self._finite = max_distance < np.inf
    groups = targets.geomgroup
    # A group is cast against unless its entry is 0; -1 everywhere means no filter.
    self._groups = vec6(*([-1] * 6 if groups is None else [-1 if group else 0 for group in groups]))
    self._has_fixed = bool(len(targets.fixed))
    self._others_are_simple = not np.isin(model.geom_type[targets.others], _MADE_OF_TRIANGLES).any()
    with wp.ScopedDevice(engine._wp_device):
      self._fixed: FixedTriangles | None = None
      if self._has_fixed and self._others_are_simple:
        key = targets.fixed.tobytes()
        if key not in engine._fixed_triangles:
          engine._fixed_triangles[key] = FixedTriangles(model, targets.fixed)
        self._fixed = engine._fixed_triangles[key]
      self._no_owner: Any = wp.zeros(0, dtype=wp.int32)
      self._others: Any = wp.array(targets.others, dtype=wp.int32)
      self._bodyexclude: Any = wp.array(targets.bodyexclude, dtype=wp.int32)
      self._origins: Any = wp.zeros((num_envs, num_rays), dtype=wp.vec3)
      self._directions: Any = wp.zeros((num_envs, num_rays), dtype=wp.vec3)
      self._distance: Any = wp.full((num_envs, num_rays), -1.0, dtype=wp.float32)
      self._geomid: Any = wp.full((num_envs, num_rays), -1, dtype=wp.int32)
      self._normal: Any = wp.zeros((num_envs, num_rays), dtype=wp.vec3)
    self._origins_torch = wp.to_torch(self._origins)
    self._directions_torch = wp.to_torch(self._directions)
    self._hits = RayHits(
      distance=wp.to_torch(self._distance),
      geomid=wp.to_torch(self._geomid) if geomid else None,
      normal=wp.to_torch(self._normal),
    )

  def cast(self, origins: torch.Tensor, directions: torch.Tensor, *, fixed: bool) -> RayHits:
    self._origins_torch.copy_(origins)
    self._directions_torch.copy_(directions)
    if self._others_are_simple and (fixed or not self._has_fixed):
      self._engine._run(self._name, self._search)
    else:
      self._engine._run(f"{self._name} against all", self._search_all)
      if self._finite:
        hits = self._hits
        too_far = hits.distance > self._max_distance
        hits.distance.masked_fill_(too_far, -1.0)
        hits.normal.masked_fill_(too_far[..., None], 0.0)
        if hits.geomid is not None:
          hits.geomid.masked_fill_(too_far, -1)
    return self._hits

  def _search(self) -> None:
    m, d = self._engine._m, self._engine._d
    wp.launch(
      warp_kernels.cast_rays,
      dim=self._distance.shape,
      inputs=[
        wp.uint64(0) if self._fixed is None else self._fixed.id,
        self._no_owner if self._fixed is None else self._fixed.geom,
        self._others,
        m.geom_type,
        m.geom_bodyid,
        m.geom_size,
        d.geom_xpos,
        d.geom_xmat,
        self._bodyexclude,
        self._max_distance,
        self._origins,
        self._directions,
      ],
      outputs=[self._distance, self._geomid, self._normal],
      device=self._engine._wp_device,
    )

  def _search_all(self) -> None:
    mjw.rays(
      self._engine._m,
      self._engine._d,
      self._origins,
      self._directions,
      self._groups,
      True,
      self._bodyexclude,
      self._distance,
      self._geomid,
      self._normal,
    )
