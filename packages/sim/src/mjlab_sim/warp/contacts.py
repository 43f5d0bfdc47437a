"""Contacts on MuJoCo Warp, put aside between the two halves of a step: afterwards they are those of the next one."""

from typing import Any

import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from mjlab_core import Contacts

from mjlab_sim.engine import Watched
from mjlab_sim.warp import engine_kernels as kernels


class WarpContacts:
  """Contacts of a few worlds in fixed memory.

  Args:
    m: MuJoCo Warp's model.
    d: MuJoCo Warp's data.
    num_envs: Number of worlds.
    device: Warp's device.
  """

  def __init__(self, m: Any, d: Any, num_envs: int, device: Any) -> None:
    self._m, self._d, self._device = m, d, device
    self._watched = Watched(num_envs)
    num_slots = self._watched.num_slots
    with wp.ScopedDevice(device):
      self._slot_of = wp.full(num_envs, -1, dtype=wp.int32)
      self._count = wp.zeros(num_slots, dtype=wp.int32)
    self._slots, self._counts = wp.to_torch(self._slot_of), wp.to_torch(self._count)
    self._slots[:num_slots] = torch.arange(num_slots, dtype=torch.int32, device=self._slots.device)
    self._rows: list[torch.Tensor] = []
    self.resize()

  def resize(self) -> None:
    """Follow the sizes of the data, which have grown; what was kept stays."""
    d, before = self._d, self._rows
    # Each contact in the solver has a row of constraints at least.
    shape = (self._watched.num_slots, d.njmax)
    with wp.ScopedDevice(self._device):
      self._ids: Any = wp.array(np.arange(d.naconmax), dtype=wp.int32)
      self._wrench: Any = wp.zeros(d.naconmax, dtype=wp.spatial_vector)
      self._geom = wp.zeros(shape, dtype=wp.vec2i)
      self._dist = wp.zeros(shape, dtype=wp.float32)
      self._pos, self._normal, self._force = (wp.zeros(shape, dtype=wp.vec3) for _ in range(3))
    self._rows = [wp.to_torch(rows) for rows in (self._geom, self._dist, self._pos, self._normal, self._force)]
    for rows, kept in zip(self._rows, before, strict=bool(before)):
      rows[:, : kept.shape[1]] = kept
    self._numbers = torch.arange(shape[1], device=self._slots.device)

  def record(self) -> None:
    """Keep the contacts whose forces have just been solved for."""
    d = self._d
    contact = d.contact
    self._count.zero_()
    mjw.contact_force(self._m, d, self._ids, True, self._wrench)
    wp.launch(
      kernels.record_contacts,
      dim=d.naconmax,
      inputs=[
        d.nacon,
        contact.worldid,
        contact.efc_address,
        contact.geom,
        contact.dist,
        contact.pos,
        contact.frame,
        self._wrench,
        self._slot_of,
      ],
      outputs=[self._count, self._geom, self._dist, self._pos, self._normal, self._force],
      device=self._device,
    )

  def forget(self, mask: Any) -> None:
    """Drop the contacts of worlds that were reset."""
    wp.launch(
      kernels.forget_contacts,
      dim=len(mask),
      inputs=[mask, self._slot_of],
      outputs=[self._count],
      device=self._device,
    )

  def of(self, world: int) -> Contacts[torch.Tensor]:
    """Return the contacts of a world, and keep them from now on."""
    slot, left = self._watched.slot(world)
    if left is not None:
      self._slots[left] = -1
      self._slots[world] = slot
      self._counts[slot] = 0
    geom, dist, pos, normal, force = (rows[slot] for rows in self._rows)
    found = self._numbers < self._counts[slot]
    return Contacts(found=found, geom=geom, dist=dist, pos=pos, normal=normal, force=force)
