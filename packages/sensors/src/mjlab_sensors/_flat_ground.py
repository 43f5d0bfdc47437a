"""Ground that needs no rays: one infinite horizontal plane that never moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

if TYPE_CHECKING:
  from mjlab_sim import Simulation


def plane_height(sim: Simulation, geom_groups: tuple[int, ...] | None, excluded: set[int]) -> float | None:
  """World height of the only geom in `geom_groups` if it is a fixed, infinite, horizontal plane [m]; else None.

  Geoms of bodies in `excluded`, through which some rays pass, do not count where that is one body.
  """
  model = sim.mj_model
  unseen = excluded if len(excluded) == 1 else set()
  seen = [
    geom
    for geom in range(model.ngeom)
    if (geom_groups is None or model.geom_group[geom] in geom_groups) and model.geom_bodyid[geom] not in unseen
  ]
  if len(seen) != 1 or model.geom_bodyid[seen[0]] in excluded:
    return None
  geom = seen[0]
  body = int(model.geom_bodyid[geom])
  is_fixed = model.body_weldid[body] == 0 and model.body_mocapid[model.body_rootid[body]] < 0
  is_infinite = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE and not model.geom_size[geom, :2].any()
  if not (is_fixed and is_infinite):
    return None
  data = mujoco.MjData(model)
  mujoco.mj_kinematics(model, data)
  is_level = np.allclose(data.geom_xmat[geom].reshape(3, 3)[:, 2], (0.0, 0.0, 1.0), atol=1e-9)
  return float(data.geom_xpos[geom, 2]) if is_level else None


def plane_is_fixed(sim: Simulation) -> bool:
  """Whether no world has been given geoms or bodies in other places than the model's."""
  return not any(sim.is_expanded(name) for name in ("geom_pos", "geom_quat", "body_pos", "body_quat", "geom_size"))
