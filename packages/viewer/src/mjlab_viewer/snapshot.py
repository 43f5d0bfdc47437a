"""Copies of a few worlds on the host, and the model and data into which a viewer loads them."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields

import mujoco
import numpy as np
import torch
from mjlab_core import Contacts, host_contacts

from mjlab_viewer.drawing.draw_list import DrawList
from mjlab_viewer.env import ViewedEnv

# State from which MuJoCo computes everything else, and the poses of bodies.
FIELDS = """time qpos qvel act ctrl qacc_warmstart qfrc_applied xfrc_applied mocap_pos mocap_quat eq_active
xpos xquat""".split()
_CONTACT_FIELDS = [field.name for field in fields(Contacts)]


@dataclass(kw_only=True)
class Snapshot:
  """State of some worlds at one moment."""

  worlds: tuple[int, ...]
  """Numbers of the worlds; the first is the selected one."""
  data: dict[str, np.ndarray]
  """Fields of MjData, (len(worlds), ...)."""
  model: dict[str, np.ndarray]
  """Fields of MjModel that have one value per world, (len(worlds), ...)."""
  signals: dict[str, np.ndarray]
  """Numbers of the selected world by group, (k,)."""
  drawings: list[DrawList]
  """Debug drawings: one for all worlds, or one for each."""
  contacts: Sequence[Contacts[np.ndarray]] = ()
  """Contacts of the selected world, or of each; empty if the simulation does not provide them."""
  step: int = 0
  """Number of steps done before it."""

  def is_finite(self, row: int = 0) -> bool:
    """Return True if the poses of a world are finite; a world that diverged cannot be shown."""
    return all(bool(np.isfinite(self.data[name][row]).all()) for name in ("xpos", "xquat"))


class SnapshotTaker:
  """Source of snapshots of an environment. The cost grows with the worlds in a snapshot, not with all worlds.

  All values of a snapshot come to the host in one transfer. The environment is not written to.

  Args:
    env: The environment.
    contacts: True also copies contacts, which the simulation keeps from its next step on.
  """

  def __init__(self, env: ViewedEnv, *, contacts: bool = False) -> None:
    self._env = env
    self._worlds: tuple[int, ...] = ()
    self._indices = torch.empty(0)
    self._fields = [name for name in FIELDS if getattr(env.sim.data, name).numel()]
    self._has_contacts = contacts and env.sim.contacts(0) is not None

  def take(self, worlds: Sequence[int], *, drawers: Sequence[str] = (), apart: bool = False, step: int = 0) -> Snapshot:
    """Copy some worlds.

    Args:
      worlds: Numbers of the worlds, the selected one first.
      drawers: Names of the drawers that are on.
      apart: True draws over each world by itself and copies its contacts, for pictures that show one world each.
      step: Number of steps done, stored in the snapshot.
    """
    env, worlds = self._env, tuple(worlds)
    if worlds != self._worlds:
      # The same worlds are shown for a long time; a copy of their indices each time would be one more transfer.
      self._worlds, self._indices = worlds, torch.tensor(worlds, device=env.sim.device)
    chosen, selected = self._indices, self._indices[:1]
    parts = (
      # Derived fields are brought up to date when they are read by name.
      {name: getattr(env.sim.data, name).index_select(0, chosen) for name in self._fields},
      {name: env.sim.model[name].index_select(0, chosen) for name in env.sim.expanded_fields},
      {name: values.index_select(0, selected)[0] for name, (_, values) in env.signals().items()},
    )
    drawings = [DrawList((world,)) for world in worlds] if apart else [DrawList(worlds)]
    if drawers:
      known = env.drawers()
      for drawing, name in itertools.product(drawings, drawers):
        if name in known:
          known[name](drawing)
    # The simulation has contacts of all worlds or of none.
    touching = [env.sim.contacts(world) for world in (worlds if apart else worlds[:1])] if self._has_contacts else []
    tensors = [
      *(values for part in parts for values in part.values()),
      *(tensor for drawing in drawings for tensor in drawing.pending),
      *(getattr(contacts, name) for contacts in touching for name in _CONTACT_FIELDS),
    ]
    arrived = iter(to_host(tensors))
    data, model, signals = ({name: next(arrived) for name in part} for part in parts)
    for drawing in drawings:
      drawing.finish(arrived)
    return Snapshot(
      worlds=worlds,
      data=data,
      model=model,
      signals=signals,
      drawings=drawings,
      contacts=[_found({name: next(arrived) for name in _CONTACT_FIELDS}) for _ in touching],
      step=step,
    )


def _found(arrived: dict[str, np.ndarray]) -> Contacts[np.ndarray]:
  """Return the contacts among these rows; those that are not finite are left out."""
  rows = arrived["found"].astype(bool) & np.isfinite(np.hstack([arrived["pos"], arrived["force"]])).all(axis=1)
  kept = {name: values[rows] for name, values in arrived.items()}
  return Contacts(**kept | {"found": rows[rows], "geom": kept["geom"].astype(np.int32)})


def to_host(tensors: Sequence[torch.Tensor]) -> list[np.ndarray]:
  """Return copies of tensors as arrays of doubles, in one transfer."""
  packed = torch.cat([tensor.detach().reshape(-1).double() for tensor in tensors]).cpu()
  parts = packed.split([tensor.numel() for tensor in tensors])
  return [part.reshape(tensor.shape).numpy() for part, tensor in zip(parts, tensors, strict=True)]


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
