"""Rays by MuJoCo C, and their comparison with hits."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_sim import RayHits, Simulation

Expected = tuple[np.ndarray, ...]


def mujoco_rays(
  sim: Simulation,
  origins: torch.Tensor,
  directions: torch.Tensor,
  *,
  models: Sequence[mujoco.MjModel] | None = None,
  group: np.ndarray | None = None,
  exclude: Any = -1,
) -> Expected:
  """Distance, geom and normal of each ray in the state of each world, and in its model where there are several."""
  shape = origins.shape[:2]
  distance, geom, normal = np.zeros(shape), np.full((*shape, 1), -1, dtype=np.int32), np.zeros((*shape, 3))
  exclude = np.broadcast_to(exclude, shape[1])
  for world in range(shape[0]):
    model = sim.mj_model if models is None else models[world]
    data = mujoco.MjData(model)
    for name in ("qpos", "mocap_pos", "mocap_quat"):
      getattr(data, name)[:] = getattr(sim.data, name)[world].double().numpy()
    mujoco.mj_kinematics(model, data)
    for ray in range(shape[1]):
      origin, direction = (part[world, ray].double().numpy() for part in (origins, directions))
      found = geom[world, ray], normal[world, ray]
      distance[world, ray] = mujoco.mj_ray(model, data, origin, direction, group, 1, exclude[ray], *found)
  return distance, geom[..., 0], normal


def check(hits: RayHits, expected: Expected, *, far: float = np.inf, atol: float = 2e-5, normals: float = 2e-4) -> None:
  """Equal but for rays that graze an edge, of which single precision may hit the other side."""
  distance, geom, normal = (array.copy() for array in expected)
  missed = distance > far
  distance[missed], geom[missed], normal[missed] = -1.0, -1, 0.0
  got = hits.distance.double().numpy()
  wrong = np.abs(got - distance) > atol
  assert wrong.mean() < 0.01
  assert ((distance < 0) == (got < 0))[~wrong].all()
  np.testing.assert_allclose(hits.normal.double().numpy()[~wrong], normal[~wrong], atol=normals)
  if hits.geomid is not None:
    assert (hits.geomid.numpy() == geom)[~wrong].mean() > 0.99
