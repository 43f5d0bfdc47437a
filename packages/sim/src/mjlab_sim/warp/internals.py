"""Private names of MuJoCo Warp, all in this module.

`PRIVATE` lists them with the reason. The requirement is bounded to the `TESTED` minor. With another one nothing private
is used: constants and rays take public functions, which are slower.

Two public ways are not taken; `tools/compare_warp_paths.py` measures both. `mjw.rays(rc=...)` excludes one body per
ray, not a kinematic tree, and refits a tree of all geoms in every world before a cast. `opt.run_qacc_smooth=False`
saves a factorisation per step, with the same motion, but leaves `qacc_smooth` stale.
"""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

import mujoco_warp as mjw

TESTED = "4.0"
PRIVATE = {
  "mujoco_warp._src.collision_driver.nxn_broadphase": "gives way to groups of geoms; else every pair is tested",
  "mujoco_warp._src.collision_driver._broadphase_filter": "tests a pair, for the same",
  "mujoco_warp._src.collision_driver._mesh_missing": "leaves out meshes that a world has not, for the same",
  "mujoco_warp._src.collision_driver._add_geom_pair": "lists a pair as MuJoCo Warp's own kernel does",
  "mujoco_warp._src.collision_driver.convex_narrowphase": "collides height fields our way; else one thread per pair",
  "mujoco_warp._src.collision_convex._hfield_filter": "finds the cells under a geom, for the same; else none is needed",
  "mujoco_warp._src.collision_core.contact_margin_gap": "gives margins of a pair, for collisions with height fields",
  "mujoco_warp._src.collision_core.contact_params": "gives all parameters of a contact, for the same",
  "mujoco_warp._src.collision_core.geom_collision_pair": "reads two geoms, for the same",
  "mujoco_warp._src.collision_core.write_contact": "writes a contact as the other collisions do",
  "mujoco_warp._src.collision_gjk.ccd": "collides a geom and a prism, as MuJoCo Warp's own kernel does",
  "mujoco_warp._src.collision_gjk.support": "gives the lowest point of a geom, to leave out prisms below it",
  "mujoco_warp._src.math.make_frame": "makes a contact's frame from its normal, as for other contacts",
  "mujoco_warp._src.math.upper_trid_index": "finds how many pairs of two types a model has",
  "mujoco_warp._src.ray.ray_geom": "casts a ray against one primitive inside a kernel; else `mjw.rays` casts all",
  "mujoco_warp._src.render_util.compute_ray": "gives the ray of a pixel for distance images; else there are none",
  "mujoco_warp._src.solver.solve": "gives way to the fused solver inside of a step; else MuJoCo Warp solves",
  "mujoco_warp._src.smooth.tendon_armature": "completes the inertia at qpos0; else `mjw.set_const` solves row by row",
}
IS_TESTED = mjw.__version__.startswith(TESTED + ".")
"""True for the minor whose private names are known."""

ray_geom: Any = None
compute_ray: Any = None
tendon_armature: Any = None
solver: Any = None
collision_driver: Any = None
nxn_broadphase: Any = None
convex_narrowphase: Any = None
broadphase_filter: Any = None
mesh_missing: Any = None
add_geom_pair: Any = None
hfield_filter: Any = None
contact_margin_gap: Any = None
contact_params: Any = None
geom_collision_pair: Any = None
write_contact: Any = None
ccd: Any = None
support: Any = None
make_frame: Any = None
upper_trid_index: Any = None

if IS_TESTED:
  from mujoco_warp._src import (
    collision_convex,
    collision_core,
    collision_driver,
    collision_gjk,
    math,
    ray,
    render_util,
    smooth,
    solver,
  )

  nxn_broadphase = collision_driver.nxn_broadphase
  convex_narrowphase = collision_driver.convex_narrowphase
  broadphase_filter = collision_driver._broadphase_filter
  mesh_missing, add_geom_pair = collision_driver._mesh_missing, collision_driver._add_geom_pair
  hfield_filter = collision_convex._hfield_filter
  contact_margin_gap = collision_core.contact_margin_gap
  contact_params = collision_core.contact_params
  geom_collision_pair = collision_core.geom_collision_pair
  write_contact = collision_core.write_contact
  ccd, support = collision_gjk.ccd, collision_gjk.support
  make_frame, upper_trid_index = math.make_frame, math.upper_trid_index

  ray_geom = ray.ray_geom
  compute_ray = render_util.compute_ray
  tendon_armature = smooth.tendon_armature


@contextmanager
def stepping_with(
  solve: Callable[..., None] | None,
  broadphase: Callable[..., None] | None,
  narrowphase: Callable[..., None] | None,
) -> Generator[None]:
  """Have steps of MuJoCo Warp call these meanwhile, instead of its own solver and collisions; None keeps its own."""
  ours = [
    (solver, "solve", solve),
    (collision_driver, "nxn_broadphase", broadphase),
    (collision_driver, "convex_narrowphase", narrowphase),
  ]
  replaced = [(owner, name, getattr(owner, name), call) for owner, name, call in ours if call is not None]
  for owner, name, _, call in replaced:
    setattr(owner, name, call)
  try:
    yield
  finally:
    for owner, name, before, _ in replaced:
      setattr(owner, name, before)
