"""Copies of a few worlds on the host."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from mjlab_core import Contacts

from mjlab_viewer.drawing.draw_list import DrawList
from mjlab_viewer.env import ViewedEnv

# State from which MuJoCo computes everything else, and the poses of bodies.
FIELDS = """time qpos qvel act ctrl qacc_warmstart qfrc_applied xfrc_applied mocap_pos mocap_quat eq_active
xpos xquat""".split()


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
  """Takes snapshots of an environment. The cost grows with the worlds in a snapshot, not with all worlds.

  All values of a snapshot come to the host in one transfer. The environment is not written to.

  Args:
    env: The environment.
    contacts: True also copies contacts, which the simulation keeps from its next step on.
  """

  def __init__(self, env: ViewedEnv, *, contacts: bool = False) -> None:
    self._env = env
    self._indices: dict[tuple[int, ...], torch.Tensor] = {}
    data = env.sim.data
    self._fields = {name: value for name in FIELDS if (value := getattr(data, name)).numel()}
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
    chosen = self._indices.get(worlds)
    if chosen is None:
      # The same worlds are shown for a long time; a copy of their indices each time would be one more transfer.
      self._indices = {worlds: torch.tensor(worlds, device=env.sim.device)}
      chosen = self._indices[worlds]
    selected = chosen[:1]
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
    rows = [values for part in parts for values in part.values()]
    touching = [env.sim.contacts(world) for world in (worlds if apart else worlds[:1])] if self._has_contacts else []
    kept = [(c.found, c.geom, c.dist, c.pos, c.normal, c.force) for c in touching if c is not None]
    arrived = iter(
      to_host(
        rows + [tensor for drawing in drawings for tensor in drawing.pending] + [tensor for c in kept for tensor in c]
      )
    )
    data, model, signals = ({name: next(arrived) for name in part} for part in parts)
    for drawing in drawings:
      drawing.finish(arrived)
    contacts = [_contacts(*itertools.islice(arrived, 6)) for _ in kept]
    return Snapshot(
      worlds=worlds,
      data=data,
      model=model,
      signals=signals,
      drawings=drawings,
      contacts=contacts,
      step=step,
    )


def _contacts(
  found: np.ndarray, geom: np.ndarray, dist: np.ndarray, pos: np.ndarray, normal: np.ndarray, force: np.ndarray
) -> Contacts[np.ndarray]:
  rows = found.astype(bool) & np.isfinite(pos).all(axis=1) & np.isfinite(force).all(axis=1)
  return Contacts(
    found=rows[rows],
    geom=geom[rows].astype(np.int32),
    dist=dist[rows],
    pos=pos[rows],
    normal=normal[rows],
    force=force[rows],
  )


def to_host(tensors: Sequence[torch.Tensor]) -> list[np.ndarray]:
  """Return copies of tensors as arrays, in one transfer where they are on a device."""
  if not tensors:
    return []
  if all(tensor.device.type == "cpu" for tensor in tensors):
    return [np.array(tensor.detach().numpy()) for tensor in tensors]
  packed = torch.cat([tensor.detach().reshape(-1).double() for tensor in tensors]).cpu().numpy()
  arrays, start = [], 0
  for tensor in tensors:
    stop = start + tensor.numel()
    arrays.append(packed[start:stop].reshape(tensor.shape))
    start = stop
  return arrays
