"""The hand of the one who watches."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import torch

from mjlab_viewer.errors import ViewerError
from mjlab_viewer.worlds import ViewedSim


def floating_dofs(model: mujoco.MjModel) -> int | None:
  """The first of the six degrees of freedom of the first body that floats, None if none does."""
  free = (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).nonzero()[0]
  return int(model.jnt_dofadr[free[0]]) if len(free) else None


def push(sim: ViewedSim, world: int, velocity: Sequence[float]) -> None:
  """Add a velocity, world frame (3,) [m/s], to the first floating body of one world.

  Raises:
    ViewerError: no body floats.
  """
  first = floating_dofs(sim.mj_model)
  if first is None:
    raise ViewerError("nothing to push: no body of the model floats")
  qvel: torch.Tensor = sim.data.qvel
  qvel[world, first : first + 3] += torch.as_tensor(velocity, dtype=qvel.dtype, device=qvel.device)
