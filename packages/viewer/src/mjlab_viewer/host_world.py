"""A viewer's own model and data, which a snapshot's worlds are loaded into."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from mjlab_viewer.contacts import HostContacts, computed_contacts
from mjlab_viewer.snapshot import Snapshot

_STATE = """time qpos qvel act ctrl qacc_warmstart qfrc_applied xfrc_applied mocap_pos mocap_quat eq_active""".split()


class HostWorld:
  """One world on the host. The simulation's model is copied, so nothing that is done here reaches it."""

  def __init__(self, model: mujoco.MjModel) -> None:
    self.model: mujoco.MjModel = copy.copy(model)
    # A world that diverged is shown as it is, not silently restarted.
    self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET.value
    self.data = mujoco.MjData(self.model)

  def load(self, snapshot: Snapshot, row: int = 0) -> None:
    """Take over one world of a snapshot, with its own values of the model, and compute what follows from its state."""
    copy_world(snapshot, row, self.model, self.data)
    mujoco.mj_forward(self.model, self.data)

  def contacts(self, snapshot: Snapshot, row: int = 0) -> HostContacts:
    """Contacts of the world that was loaded: the simulation's own, or else what MuJoCo C makes of its state."""
    return snapshot.contacts[row] if row < len(snapshot.contacts) else computed_contacts(self.model, self.data)


def copy_world(snapshot: Snapshot, row: int, model: mujoco.MjModel, data: mujoco.MjData) -> None:
  """Write one world of a snapshot into a model and data of one's own; nothing is computed from it."""
  for name, rows in snapshot.model.items():
    owner = model.opt if name.startswith("opt.") else model
    _assign(owner, name.removeprefix("opt."), rows[row])
  for name in _STATE:
    if name in snapshot.data:
      _assign(data, name, snapshot.data[name][row])


def _assign(owner: object, name: str, value: np.ndarray) -> None:
  field = getattr(owner, name)
  if isinstance(field, np.ndarray):
    field[...] = value.reshape(field.shape)
  else:
    setattr(owner, name, type(field)(value))
