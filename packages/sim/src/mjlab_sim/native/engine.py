"""MuJoCo's own engine: every world on all cores of a CPU, in float64, with nothing to compile."""

import copy
import ctypes
import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import torch
from mjlab_core import Contacts, MjlabError
from mjlab_core.torch_internals import version_of
from mujoco import batch

from mjlab_sim.config import SimulationCfg
from mjlab_sim.fields import KINEMATIC_STATE, STATE, owner_of
from mjlab_sim.native.contacts import NativeContacts
from mjlab_sim.native.rays import NativeRayCaster, ground_model
from mjlab_sim.rays import Rays, RayTargets
from mjlab_sim.rendering import Draw, View
from mjlab_sim.tensors import TorchArray

if TYPE_CHECKING:
  from mjlab_sim.warp.rendering import Renderers

_NONE = mujoco.mjtStage.mjSTAGE_NONE.value
_VEL = mujoco.mjtStage.mjSTAGE_VEL.value
_BUFFERS = {
  "contacts": mujoco.mjtWarning.mjWARN_CONTACTFULL.value,
  "constraints": mujoco.mjtWarning.mjWARN_CNSTRFULL.value,
}
"""The warning of each buffer that can be too small."""
_DIVERGED = "Nan, Inf or huge value"


@functools.cache
def _print_once(warning: str) -> None:
  print(f"MuJoCo: {warning}")


def _quiet(message: str) -> None:
  # A diverged world is reset and counted by its owner; MuJoCo would add a file to the working directory. All other
  # warnings come from every world, and again after each reset: the part before the numbers is printed once.
  if not message.startswith(_DIVERGED):
    _print_once(message.split(". ")[0])


def _writable(array: np.ndarray) -> np.ndarray:
  """Return an alias of an array that the batch marks read-only: torch has no read-only tensors."""
  memory: Any = (ctypes.c_byte * array.nbytes).from_address(array.ctypes.data)
  return np.frombuffer(memory, dtype=array.dtype).reshape(array.shape)


def _shaped(array: np.ndarray, name: str) -> np.ndarray:
  """MuJoCo's flat rows as matrices, and bounding boxes as centre and half sizes."""
  if name == "geom_aabb":
    return array.reshape(*array.shape[:-1], 2, 3)
  if name.endswith(("mat", "mat0")) and array.shape[-1] == 9:
    return array.reshape(*array.shape[:-1], 3, 3)
  return array


@dataclass
class _ModelField:
  """Field of the model."""

  tensor: TorchArray
  version: int
  """Version of the tensor when it was last looked at."""
  rows: np.ndarray | None = None
  """Values of all worlds then; None while worlds share the field."""


class NativeEngine:
  """`mujoco.batch.Batch` behind the engine protocol."""

  dtype = torch.float64

  def __init__(self, model: mujoco.MjModel, num_envs: int, cfg: SimulationCfg) -> None:
    model = copy.copy(model)
    # MuJoCo C would silently restart a diverged world; termination terms must see it instead.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET.value
    if mujoco.get_mju_user_warning() is None:
      mujoco.set_mju_user_warning(_quiet)
    self._model = model
    self._num_envs = num_envs
    self._batch = batch.Batch(model, num_envs, cfg.num_threads, persistent=True)
    self._data: dict[str, TorchArray] = {}
    self._model_fields: dict[str, _ModelField] = {}
    self._grounds: dict[bytes, batch.Batch] = {}
    self._renderers: Renderers | None = None
    self._contacts: NativeContacts | None = None
    self._batch.reset(stage=_VEL)
    self._kinematic = [self._batch.bind(name) for name in KINEMATIC_STATE]
    self._seen = [array.copy() for array in self._kinematic]
    self._stale = np.zeros(num_envs, dtype=bool)
    self._overflowed = np.zeros((num_envs, len(_BUFFERS)), dtype=bool)
    self._is_reported = False

  def data_field(self, name: str) -> TorchArray:
    if name not in self._data:
      if name not in batch.DATA_FIELDS:
        raise KeyError(name)
      array = self._batch.bind(name)
      if name not in STATE:
        array = _writable(array)
        # An output that is bound between calls is empty until the next call.
        self._batch.forward(stage=_VEL)
      self._data[name] = TorchArray.over(lambda: torch.from_numpy(_shaped(array, name)))
    return self._data[name]

  def model_field(self, name: str) -> TorchArray:
    if name not in self._model_fields:
      rows = self._batch.expanded(name)
      # The batch derives constants for each world; while their sources are shared, all worlds have the same.
      value = np.array(getattr(*owner_of(self._model, name)))[None] if rows is None else rows[:1].copy()
      field = TorchArray.over(lambda: torch.from_numpy(_shaped(value, name)))
      self._model_fields[name] = _ModelField(field, version_of(field))
    return self._model_fields[name].tensor

  def expand(self, name: str) -> None:
    shared = self.model_field(name)
    rows = _shaped(self._batch.expand(name), name)
    field = TorchArray.over(lambda: torch.from_numpy(rows))
    field.copy_(shared)
    self._model_fields[name] = _ModelField(field, version_of(field), rows.copy())
    # A write to the shared field may not have been seen.
    self._stale[:] = True

  def step(self) -> None:
    if self._contacts is not None:
      self._contacts.record()
    self._batch.step(stage=_VEL)
    self._remember()

  def forward(self, model_changed: bool) -> None:
    if model_changed:
      self._take_model_writes()
    for array, seen in zip(self._kinematic, self._seen, strict=True):
      # NaN compares unequal to itself, so a world that holds one always counts as written.
      self._stale |= (array != seen).reshape(self._num_envs, -1).any(axis=1)
    if self._stale.any():
      self._batch.forward(self._stale, stage=_VEL)
      self._remember()

  def _take_model_writes(self) -> None:
    """Pass writes to shared fields on to the batch, and mark the worlds whose constants were written.

    The batch runs on its own copy of the model, so that a write to a shared field reaches it as equal values for all
    worlds. Most resets are of few worlds, and so are their draws.
    """
    for name, field in self._model_fields.items():
      if version_of(field.tensor) == field.version:
        continue
      field.version = version_of(field.tensor)
      now = field.tensor.numpy()
      if field.rows is None:
        _shaped(self._batch.expand(name), name)[:] = now
        self._stale[:] = True
      else:
        self._stale |= (now != field.rows).reshape(self._num_envs, -1).any(axis=1)
        np.copyto(field.rows, now)

  def _remember(self) -> None:
    for array, seen in zip(self._kinematic, self._seen, strict=True):
      np.copyto(seen, array)
    self._stale[:] = False

  def reset(self, mask: torch.Tensor) -> None:
    worlds = mask.numpy()
    if worlds.any():
      self._count_overflow()
      self._batch.reset(worlds, stage=_NONE)
      self._stale |= worlds
      if self._contacts is not None:
        self._contacts.forget(worlds)

  def recompute_constants(self, mask: torch.Tensor | None) -> None:
    self._take_model_writes()
    worlds = None if mask is None else mask.numpy()
    try:
      self._batch.set_const(worlds)
    except batch.SimulationError as error:
      raise MjlabError(f"recompute_constants: {error}") from error
    self._stale |= True if worlds is None else worlds
    one = 0 if worlds is None else int(worlds.argmax())
    for name, field in self._model_fields.items():
      if field.rows is None and (rows := self._batch.expanded(name)) is not None:
        field.tensor.numpy()[0] = _shaped(rows, name)[one]

  def ray_caster(self, targets: RayTargets, rays: Rays) -> Callable[[bool], None]:
    ground = self._ground(targets) if rays.hits.geomid is None else None
    return NativeRayCaster(self._batch, targets, rays, ground).cast

  def _ground(self, targets: RayTargets) -> batch.Batch | None:
    """Return the fixed geoms by themselves, where that is faster; casters that see the same ones share them."""
    key = targets.ground.tobytes()
    if key not in self._grounds:
      ground = ground_model(self._model, targets)
      if ground is None:
        return None
      self._grounds[key] = batch.Batch(ground, self._num_envs, self._batch.nthread, persistent=True)
    return self._grounds[key]

  def renderer(self, view: View, images: Mapping[str, torch.Tensor]) -> Draw:
    if self._renderers is None:
      # Warp is loaded when the first image is asked for.
      from mjlab_sim.native.rendering import native_renderers

      self._renderers = native_renderers(self._model, self._batch, self.data_field)
    return self._renderers.add(view, images)

  def contacts(self, world: int) -> Contacts[torch.Tensor]:
    if self._contacts is None:
      self._contacts = NativeContacts(self._batch)
    return self._contacts.of(world)

  def _count_overflow(self) -> None:
    # The batch counts warnings itself, but a reset forgets them.
    self._overflowed |= self._batch.warning[:, list(_BUFFERS.values()), 1] > 0

  @property
  def buffer_sizes(self) -> dict[str, int]:
    return {}

  def make_room(self, at_least: Mapping[str, int]) -> bool:
    return False

  def overflow_report(self) -> list[str]:
    self._count_overflow()
    dropped = [what for what, worlds in zip(_BUFFERS, self._overflowed.T, strict=True) if worlds.any()]
    if not dropped or self._is_reported:
      return []
    self._is_reported = True
    worlds = np.count_nonzero(self._overflowed.any(axis=1))
    return [
      f"{worlds} of {self._num_envs} worlds ran out of MuJoCo's memory and dropped {' and '.join(dropped)}."
      f' Set <size memory="{max(4 * self._model.narena, 2**20)}"/> in the model.'
    ]
