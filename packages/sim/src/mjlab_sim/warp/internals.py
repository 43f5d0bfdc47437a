"""Private names of MuJoCo Warp, all in this module.

`PRIVATE` lists them with the reason. The requirement is bounded to the `TESTED` minor. With another one nothing private
is used: constants and rays take public functions, which are slower.

Two public ways are not taken; `tools/compare_warp_paths.py` measures both. `mjw.rays(rc=...)` excludes one body per
ray, not a kinematic tree, refits a tree of all geoms in every world before a cast, and misses where two boxes touch.
`opt.run_qacc_smooth=False` saves a factorisation per step, with the same motion, but leaves `qacc_smooth` stale.
"""

import contextlib
import importlib
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from typing import Any

import mujoco_warp as mjw

from mjlab_sim.warp.solver.tile_solvers import replaced

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
  "mujoco_warp._src.render_util.compute_ray": "gives the ray of a pixel for distance images; else they are missing",
  "mujoco_warp._src.solver.solve": "gives way to the fused solver inside of a step; else MuJoCo Warp solves",
  "mujoco_warp._src.smooth.tendon_armature": "completes the inertia at qpos0; else `mjw.set_const` solves row by row",
}
IS_TESTED = mjw.__version__.startswith(TESTED + ".")
"""True for the minor whose private names are known."""


_FOUND: dict[str, Any] = {}
# Found once: inside of `stepping_with` some are replaced.
for _path in PRIVATE:
  _module, _, _name = _path.rpartition(".")
  _FOUND[_name.lstrip("_")] = getattr(importlib.import_module(_module), _name) if IS_TESTED else None


def __getattr__(name: str) -> Any:
  """Return an object of `PRIVATE` by its name without underscore; None if MuJoCo Warp is of another minor."""
  if name not in _FOUND:
    raise AttributeError(name)
  return _FOUND[name]


@contextmanager
def stepping_with(calls: Mapping[str, Callable[..., None]]) -> Generator[None]:
  """Have steps of MuJoCo Warp call these functions instead of those of `PRIVATE` with the same name."""
  with contextlib.ExitStack() as stack:
    for path in PRIVATE:
      module, _, name = path.rpartition(".")
      if name in calls:
        stack.enter_context(replaced(importlib.import_module(module), name, calls[name]))
    yield
