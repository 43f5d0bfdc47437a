"""Contacts of one world, as a simulation computed them and as a viewer shows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
  import numpy as np
  import torch

Array = TypeVar("Array", "np.ndarray", "torch.Tensor")


@dataclass(kw_only=True)
class Contacts(Generic[Array]):
  """Contacts of one world in one physics step, at most n of them, as NumPy arrays or torch tensors.

  Contacts that are only near, within a geom's gap, are left out.
  """

  found: Array
  """True for the rows that are contacts; the other rows are undefined, bool (n,)."""
  geom: Array
  """The two geoms, -1 for a flex, int32 (n, 2)."""
  dist: Array
  """Distance between the surfaces, negative in penetration, (n,) [m]."""
  pos: Array
  """Contact point, world frame, (n, 3) [m]."""
  normal: Array
  """Unit normal from the first geom to the second, world frame, (n, 3)."""
  force: Array
  """Force of the first geom on the second, world frame, (n, 3) [N]."""


def host_contacts(model: Any, data: Any) -> Contacts[np.ndarray]:
  """Return the contacts of an `MjData` with solved constraint forces.

  Forces are those of `mj_contactForce`, bit for bit, for all contacts at once.

  Args:
    model: The `MjModel`.
    data: Its `MjData` after `mj_forward` or `mj_step`.
  """
  import numpy as np

  contact = data.contact
  rows = np.flatnonzero(contact.efc_address >= 0)
  first, dim, friction = contact.efc_address[rows], contact.dim[rows], contact.friction[rows]
  frame = contact.frame[rows].reshape(-1, 3, 3)
  local = np.zeros((len(rows), 3))

  def solved(numbers: np.ndarray, offset: int) -> np.ndarray:
    return data.efc_force[first[numbers] + offset]

  is_pyramid = (model.opt.cone == 0) & (dim > 1)
  for axis in range(3):
    with_axis = np.flatnonzero(~is_pyramid & (dim > axis))
    local[with_axis, axis] = solved(with_axis, axis)
  # Edges of a pyramid come in pairs, one pair for each direction of friction.
  for pair in range(5):
    edges = np.flatnonzero(is_pyramid & (dim > pair + 1))
    one, other = solved(edges, 2 * pair), solved(edges, 2 * pair + 1)
    local[edges, 0] = local[edges, 0] + one + other
    if pair < 2:
      local[edges, 1 + pair] = (one - other) * friction[edges, pair]
  local[:, 0] -= contact.adhesion[rows]
  return Contacts(
    found=np.ones(len(rows), dtype=bool),
    geom=contact.geom[rows],
    dist=contact.dist[rows],
    pos=contact.pos[rows],
    normal=frame[:, 0].copy(),
    force=np.einsum("nij,ni->nj", frame, local),
  )
