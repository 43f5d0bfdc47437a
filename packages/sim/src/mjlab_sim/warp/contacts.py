"""Contacts on MuJoCo Warp, copied between the two halves of a step: afterwards they are those of the next one."""

from typing import Any

import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from mjlab_core import Contacts


class WarpContacts:
  """Contacts of all worlds in the last step, in fixed memory.

  Args:
    m: MuJoCo Warp's model.
    d: MuJoCo Warp's data.
  """

  _NAMES = ("worldid", "efc_address", "geom", "dist", "pos", "frame")

  def __init__(self, m: Any, d: Any) -> None:
    self._m, self._d = m, d
    self._count: Any = wp.zeros_like(d.nacon)
    self._has_stepped: Any = wp.zeros(d.nworld, dtype=bool, device=d.nacon.device)
    self._arrays: dict[str, Any] = {}
    self.resize()

  def resize(self) -> None:
    """Follow the sizes of the data, which have grown; kept contacts stay."""
    before, d = self._arrays, self._d
    with wp.ScopedDevice(d.nacon.device):
      self._ids: Any = wp.array(np.arange(d.naconmax), dtype=wp.int32)
      self._arrays = {name: wp.zeros_like(getattr(d.contact, name)) for name in self._NAMES}
      self._arrays["wrench"] = wp.zeros(d.naconmax, dtype=wp.spatial_vector)
    for name, array in before.items():
      wp.copy(self._arrays[name], array)

  def record(self) -> None:
    """Keep the contacts whose forces have just been solved for."""
    for name in self._NAMES:
      wp.copy(self._arrays[name], getattr(self._d.contact, name))
    wp.copy(self._count, self._d.nacon)
    mjw.contact_force(self._m, self._d, self._ids, True, self._arrays["wrench"])
    self._has_stepped.fill_(True)

  def forget(self, mask: torch.Tensor) -> None:
    """Drop the contacts of worlds that were reset, bool (num_envs,)."""
    wp.to_torch(self._has_stepped).logical_and_(~mask)

  def of(self, world: int) -> Contacts[torch.Tensor]:
    """Return the contacts of a world. Reads the device."""
    kept = {name: wp.to_torch(array) for name, array in self._arrays.items()}
    found = (kept["worldid"] == world) & (kept["efc_address"][:, 0] >= 0)
    found[int(wp.to_torch(self._count)[0]) :] = False
    rows = (found & wp.to_torch(self._has_stepped)[world]).nonzero().squeeze(1)
    geom, dist, pos, frame, wrench = (kept[name][rows] for name in ("geom", "dist", "pos", "frame", "wrench"))
    found = torch.ones_like(rows, dtype=torch.bool)
    return Contacts(found=found, geom=geom, dist=dist, pos=pos, normal=frame[:, 0], force=wrench[:, :3])
