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

if IS_TESTED:
  from mujoco_warp._src import ray, render_util, smooth, solver

  ray_geom = ray.ray_geom
  compute_ray = render_util.compute_ray
  tendon_armature = smooth.tendon_armature


@contextmanager
def solving_with(solve: Callable[[mjw.Model, mjw.Data], None]) -> Generator[None]:
  """Have steps of MuJoCo Warp call `solve` meanwhile instead of its own constraint solver."""
  before = solver.solve
  solver.solve = solve
  try:
    yield
  finally:
    solver.solve = before
