"""Gymnasium spaces of an environment."""

from collections.abc import Sequence

import gymnasium
import numpy as np
from mjlab_managers import ObservationManager


def box(shape: Sequence[int]) -> gymnasium.spaces.Box:
  """Return an unbounded float32 box."""
  return gymnasium.spaces.Box(-np.inf, np.inf, tuple(shape), np.float32)


def observation_space(manager: ObservationManager) -> gymnasium.spaces.Dict:
  """Return the space of one world: a box per group, or a dict of boxes for a group that is not concatenated."""
  spaces: dict[str, gymnasium.Space] = {}
  for group, observation in manager.buffers.items():
    if isinstance(observation, dict):
      spaces[group] = gymnasium.spaces.Dict({term: box(value.shape[1:]) for term, value in observation.items()})
    else:
      spaces[group] = box(observation.shape[1:])
  return gymnasium.spaces.Dict(spaces)


def batched(space: gymnasium.Space, num_envs: int) -> gymnasium.Space:
  """Return the same space with a row for every world."""
  if isinstance(space, gymnasium.spaces.Dict):
    return gymnasium.spaces.Dict({name: batched(part, num_envs) for name, part in space.spaces.items()})
  assert space.shape is not None
  return box((num_envs, *space.shape))
