"""Rays against the geoms of every world."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import torch

from mjlab_sim.errors import SimulationError

if TYPE_CHECKING:
  from mjlab_sim.simulation import Simulation


@dataclass(kw_only=True)
class RayHits:
  """What the rays of one cast hit; the tensors are the caster's own and hold until its next cast."""

  distance: torch.Tensor
  """Distance along each ray, in lengths of its direction; -1 where nothing was hit, (num_envs, num_rays) [m]."""
  geomid: torch.Tensor | None
  """Geom that was hit, -1 where nothing was, (num_envs, num_rays); None if the caster was made without."""
  normal: torch.Tensor
  """Surface normal at the hit, world frame; zero where nothing was hit, (num_envs, num_rays, 3)."""


class RayCaster(Protocol):
  """Casts a fixed number of rays in every world, inside a captured step too."""

  origins: torch.Tensor
  """Where the rays of the next cast start, world frame, (num_envs, num_rays, 3) [m]; write it in place."""
  directions: torch.Tensor
  """Unit directions of the rays of the next cast, world frame, (num_envs, num_rays, 3); write it in place."""

  def cast(self, origins: torch.Tensor | None = None, directions: torch.Tensor | None = None) -> RayHits:
    """Cast the rays in `origins` and `directions`; what is given is written there first."""
    ...


class EngineRayCaster(Protocol):
  """An engine's own caster."""

  origins: torch.Tensor
  directions: torch.Tensor

  def cast(self, *, fixed: bool) -> RayHits:
    """Cast its rays; `fixed` tells whether geoms that never move are where the compiled model has them."""
    ...


class FreshRayCaster:
  """An engine's caster that sees geoms where the written state, and the written model, put them."""

  def __init__(self, sim: "Simulation", caster: EngineRayCaster) -> None:
    self._sim = sim
    self._caster = caster
    self.origins = caster.origins
    self.directions = caster.directions

  def cast(self, origins: torch.Tensor | None = None, directions: torch.Tensor | None = None) -> RayHits:
    for name, given, rays in (("origins", origins, self.origins), ("directions", directions, self.directions)):
      if given is not None:
        if given.shape != rays.shape:
          raise SimulationError(f"cast: {name} must have shape {tuple(rays.shape)}, got {tuple(given.shape)}")
        rays.copy_(given)
    self._sim._check_open()
    self._sim._refresh()
    return self._caster.cast(fixed=self._sim.fixed_geoms_are_in_place())
