"""Contacts on a CPU: MuJoCo C computes them once more for the worlds that somebody looks at.

The batch is one step ahead: what it has of contacts after a step belongs to the next one, and has no forces yet. So the
state that a step starts from is kept, and the forward pass of that step is run again from it, in the same code and
precision and from the same warm start: it is the same bit for bit.
"""

import copy

import mujoco
import numpy as np
import torch
from mjlab_core import Contacts, host_contacts
from mujoco import batch

from mjlab_sim.engine import Watched
from mjlab_sim.fields import STATE, put


class NativeContacts:
  """Keeps the state of a few worlds before the last step.

  Args:
    worlds: All worlds.
  """

  def __init__(self, worlds: batch.Batch) -> None:
    self._worlds = worlds
    self._watched = Watched(worlds.nsim)
    self._chosen = np.array(self._watched.worlds)
    live = {name: worlds.bind(name) for name in STATE}
    self._live = {name: rows for name, rows in live.items() if rows.size}
    self._before = {name: rows[self._chosen].copy() for name, rows in self._live.items()}
    self._is_stepped = np.zeros(len(self._chosen), dtype=bool)
    self._model = copy.copy(worlds.model)
    self._data = mujoco.MjData(self._model)

  def remember(self) -> None:
    """Keep what the step about to be done starts from."""
    for name, rows in self._live.items():
      np.take(rows, self._chosen, axis=0, out=self._before[name])
    self._is_stepped[:] = True

  def forget(self, worlds: np.ndarray) -> None:
    """Worlds that were reset, bool (num_envs,), have no contacts."""
    self._is_stepped &= ~worlds[self._chosen]

  def of(self, world: int) -> Contacts[torch.Tensor]:
    """Return the contacts of a world, and keep its state from now on."""
    slot, left = self._watched.slot(world)
    if left is not None:
      self._chosen[slot] = world
      self._is_stepped[slot] = False
    model, data = self._worlds.get_model(world, self._model), self._data
    if self._is_stepped[slot]:
      for name, rows in self._before.items():
        put(data, name, rows[slot])
      mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_NONE, True)
    else:
      mujoco.mj_resetData(model, data)
    contacts = host_contacts(model, data)
    return Contacts(**{name: torch.from_numpy(field) for name, field in vars(contacts).items()})
