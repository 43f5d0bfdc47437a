"""Gymnasium spaces of an environment."""

from collections.abc import Sequence

import gymnasium
import numpy as np
from mjlab_managers import ObservationManager


def box(shape: Sequence[int]) -> gymnasium.spaces.Box:
  """An unbounded float32 box."""
  return gymnasium.spaces.Box(-np.inf, np.inf, tuple(shape), np.float32)


def observation_space(manager: ObservationManager) -> gymnasium.spaces.Dict:
  """One world's observations: a box per group, or a dict of boxes for a group that is not concatenated."""
  spaces: dict[str, gymnasium.Space] = {}
  for group, shape in manager.group_obs_dim.items():
    if isinstance(shape, dict):
      spaces[group] = gymnasium.spaces.Dict({term: box(dims) for term, dims in shape.items()})
    else:
      spaces[group] = box(shape)
  return gymnasium.spaces.Dict(spaces)
