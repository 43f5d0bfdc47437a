"""Ground that needs no rays: one infinite horizontal plane that never moves."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import mujoco
import numpy as np

if TYPE_CHECKING:
  from mjlab_sim import Simulation


def plane_height(sim: Simulation, geom_groups: Iterable[int], excluded: list[int], *, trees: bool) -> float | None:
  """World height of the only geom in `geom_groups` if it is a fixed, infinite, horizontal plane [m]; else None.

  Geoms of bodies in `excluded`, or of their kinematic `trees`, through which some rays pass, do not count where all
  rays pass through the same.
  """
  model = sim.mj_model
  owner = model.body_rootid if trees else np.arange(model.nbody)
  through = {int(owner[body]) for body in excluded}
  unseen = through if len(through) == 1 else set()
  owners = owner[model.geom_bodyid]
  seen = [g for g in range(model.ngeom) if model.geom_group[g] in geom_groups and owners[g] not in unseen]
  if len(seen) != 1 or owners[seen[0]] in through:
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
