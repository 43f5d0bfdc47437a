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

  def cast(self, origins: torch.Tensor, directions: torch.Tensor) -> RayHits:
    """Cast rays from `origins` along unit `directions`, world frame, both (num_envs, num_rays, 3) [m]."""
    ...


class EngineRayCaster(Protocol):
  """An engine's own caster."""

  def cast(self, origins: torch.Tensor, directions: torch.Tensor, *, fixed: bool) -> RayHits:
    """Cast rays; `fixed` tells whether geoms that never move are where the compiled model has them."""
    ...


class FreshRayCaster:
  """An engine's caster that sees geoms where the written state, and the written model, put them."""

  def __init__(self, sim: "Simulation", caster: EngineRayCaster, num_rays: int) -> None:
    self._sim = sim
    self._caster = caster
    self._shape = (sim.num_envs, num_rays, 3)

  def cast(self, origins: torch.Tensor, directions: torch.Tensor) -> RayHits:
    for name, rays in (("origins", origins), ("directions", directions)):
      if rays.shape != self._shape:
        raise SimulationError(f"cast: {name} must have shape {self._shape}, got {tuple(rays.shape)}")
    self._sim._check_open()
    self._sim._refresh()
    return self._caster.cast(origins, directions, fixed=self._sim._geoms_are_in_place())
