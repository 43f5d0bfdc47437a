"""Contacts on a CPU: MuJoCo C computes them again for a world that is looked at.

The batch is one step ahead: its contacts after a step belong to the next one, and have no forces yet. So the state that
a step starts from is kept, and the forward pass of that step is run again from it. Code, precision and warm start are
the same, and so is every bit of the result.
"""

import copy

import mujoco
import numpy as np
import torch
from mjlab_core import Contacts, host_contacts
from mujoco import batch

from mjlab_sim.fields import STATE, put


class NativeContacts:
  """State of all worlds before the last step.

  Args:
    worlds: All worlds.
  """

  def __init__(self, worlds: batch.Batch) -> None:
    self._worlds = worlds
    live = {name: worlds.bind(name) for name in STATE}
    self._live = {name: rows for name, rows in live.items() if rows.size}
    self._before = {name: rows.copy() for name, rows in self._live.items()}
    self._has_stepped = np.zeros(worlds.nsim, dtype=bool)
    self._model = copy.copy(worlds.model)
    self._data = mujoco.MjData(self._model)

  def record(self) -> None:
    """Keep the state that the next step starts from."""
    for name, rows in self._live.items():
      np.copyto(self._before[name], rows)
    self._has_stepped[:] = True

  def forget(self, worlds: np.ndarray) -> None:
    """Drop the contacts of worlds that were reset, bool (num_envs,)."""
    self._has_stepped &= ~worlds

  def of(self, world: int) -> Contacts[torch.Tensor]:
    """Return the contacts of a world."""
    model, data = self._worlds.get_model(world, self._model), self._data
    if self._has_stepped[world]:
      for name, rows in self._before.items():
        put(data, name, rows[world])
      mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_NONE, True)
    else:
      mujoco.mj_resetData(model, data)
    contacts = host_contacts(model, data)
    return Contacts(**{name: torch.from_numpy(field) for name, field in vars(contacts).items()})
