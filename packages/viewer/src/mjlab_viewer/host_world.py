"""Model and data of a viewer, into which worlds of a snapshot are loaded."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from mjlab_core import Contacts, host_contacts

from mjlab_viewer.snapshot import Snapshot


class HostWorld:
  """World on the host, with a copy of the simulation's model."""

  def __init__(self, model: mujoco.MjModel) -> None:
    self.model: mujoco.MjModel = copy.copy(model)
    # MuJoCo would silently reset a world that diverged.
    self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET.value
    self.data = mujoco.MjData(self.model)

  def load(self, snapshot: Snapshot, row: int = 0) -> None:
    """Copy one world of a snapshot, with its own model fields, and compute all derived quantities."""
    copy_world(snapshot, row, self.model, self.data)
    mujoco.mj_forward(self.model, self.data)

  def contacts(self, snapshot: Snapshot, row: int = 0) -> Contacts[np.ndarray]:
    """Return the contacts of the loaded world: the simulation's, or those that MuJoCo C computes from its state."""
    return snapshot.contacts[row] if row < len(snapshot.contacts) else host_contacts(self.model, self.data)


def copy_world(snapshot: Snapshot, row: int, model: mujoco.MjModel, data: mujoco.MjData) -> None:
  """Write one world of a snapshot into a model and its data, without computing anything."""
  for name, rows in snapshot.model.items():
    owner = model.opt if name.startswith("opt.") else model
    _assign(owner, name.removeprefix("opt."), rows[row])
  for name, rows in snapshot.data.items():
    _assign(data, name, rows[row])


def _assign(owner: object, name: str, value: np.ndarray) -> None:
  field = getattr(owner, name)
  if isinstance(field, np.ndarray):
    field[...] = value.reshape(field.shape)
  else:
    setattr(owner, name, type(field)(value))
