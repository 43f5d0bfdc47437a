"""Rays against the geoms of every world."""

from dataclasses import dataclass
from typing import Protocol

import torch


@dataclass(kw_only=True)
class RayHits:
  """What the rays of one cast hit; the tensors are the caster's own and hold until its next cast."""

  distance: torch.Tensor
  """Distance along each ray, in lengths of its direction; -1 where nothing was hit, (num_envs, num_rays) [m]."""
  geomid: torch.Tensor
  """Geom that was hit; -1 where nothing was, (num_envs, num_rays)."""
  normal: torch.Tensor
  """Surface normal at the hit, world frame; zero where nothing was hit, (num_envs, num_rays, 3)."""


class RayCaster(Protocol):
  """Casts a fixed number of rays in every world, inside a captured step too."""

  def cast(self, origins: torch.Tensor, directions: torch.Tensor) -> RayHits:
    """Cast rays from `origins` along unit `directions`, world frame, both (num_envs, num_rays, 3) [m]."""
    ...
