"""A viewer's own model and data, which a snapshot's worlds are loaded into."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

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
    """Take over one world of a snapshot, with its own values of the model, and compute what follows from its state.

    Contacts and forces are those that MuJoCo computes for exactly this state, model, control and warm start.
    """
    self.load_model(snapshot, row)
    for name in _STATE:
      if name in snapshot.data:
        field = np.asarray(getattr(self.data, name))
        if name == "time":
          self.data.time = float(snapshot.data[name][row])
        else:
          field[...] = snapshot.data[name][row].reshape(field.shape)
    mujoco.mj_forward(self.model, self.data)

  def load_model(self, snapshot: Snapshot, row: int = 0) -> None:
    """Take over only the values of the model."""
    for name, rows in snapshot.model.items():
      owner = self.model.opt if name.startswith("opt.") else self.model
      name = name.removeprefix("opt.")
      field = getattr(owner, name)
      if isinstance(field, np.ndarray):
        field[...] = rows[row].reshape(field.shape)
      else:
        setattr(owner, name, type(field)(rows[row]))
