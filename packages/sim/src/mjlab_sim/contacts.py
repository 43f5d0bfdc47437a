"""Contacts of a few worlds, for whoever looks at them."""

from dataclasses import dataclass
from typing import Protocol

import torch

MOST_WORLDS = 64
"""Most worlds whose contacts are kept at a time."""


@dataclass(kw_only=True)
class Contacts:
  """Contacts of one world, as the engine had them in the physics step just done; at most n of them.

  Contacts that are only near, within a geom's gap, are left out. Bodies have moved on since by one physics step.
  """

  found: torch.Tensor
  """Whether a row is a contact; all others are undefined, bool (n,)."""
  geom: torch.Tensor
  """The two geoms, -1 for a flex, int32 (n, 2)."""
  dist: torch.Tensor
  """Distance between the surfaces, negative in penetration, (n,) [m]."""
  pos: torch.Tensor
  """Contact point, world frame, (n, 3) [m]."""
  normal: torch.Tensor
  """Unit normal from the first geom to the second, world frame, (n, 3)."""
  force: torch.Tensor
  """What the first geom exerts on the second, world frame, (n, 3) [N]."""


class EngineContacts(Protocol):
  """An engine's own record of contacts."""

  def of(self, world: int) -> Contacts:
    """Contacts of a world; none before the first step after it was first asked for, or after a reset."""
    ...


class Watched:
  """Which worlds have a slot: all where there are few, else those that were asked for last."""

  def __init__(self, num_envs: int) -> None:
    self.num_slots = min(num_envs, MOST_WORLDS)
    # Least recently asked for first.
    self._slots = {world: world for world in range(self.num_slots)}

  @property
  def worlds(self) -> list[int]:
    """The world of each slot."""
    return sorted(self._slots, key=self._slots.__getitem__)

  def slot(self, world: int) -> tuple[int, int | None]:
    """The slot of a world, and the world that had to leave it."""
    left = None
    if world not in self._slots:
      left = next(iter(self._slots))
      self._slots[world] = self._slots.pop(left)
    else:
      self._slots[world] = self._slots.pop(world)
    return self._slots[world], left
