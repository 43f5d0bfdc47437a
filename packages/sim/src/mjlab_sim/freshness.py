"""Freshness of derived quantities: they are computed when they are read after a write to the state or the model."""

from collections.abc import Iterable

import torch
from mjlab_core import MjlabError, unknown
from mjlab_core.mujoco.model_fields import PER_WORLD
from mjlab_core.torch_internals import version_of

from mjlab_sim.engine import Engine
from mjlab_sim.fields import KINEMATIC_STATE, STATE
from mjlab_sim.tensors import TorchArray, plain, versions

_DATA_FIELDS = (
  *STATE,
  *"""qacc xpos xquat xmat xipos ximat geom_xpos geom_xmat site_xpos site_xmat cam_xpos cam_xmat subtree_com cvel
  subtree_linvel subtree_angmom sensordata actuator_force actuator_length actuator_velocity qfrc_actuator qfrc_bias
  qfrc_passive qfrc_constraint qfrc_smooth ten_length ten_velocity xanchor xaxis nefc energy""".split(),
)


class Freshness:
  """An engine whose derived quantities follow every in-place write, seen through torch's version counters.

  Args:
    engine: The worlds.
  """

  def __init__(self, engine: Engine) -> None:
    self.engine = engine
    self.version = 0
    """A number that changes whenever derived quantities do."""
    self.num_sensed = 0
    """Casts of rays and drawings of images so far."""
    self._kinematic = [plain(engine.data_field(name)) for name in KINEMATIC_STATE]
    self.num_envs = len(self._kinematic[0])
    self._state_version = versions(self._kinematic)
    self._model_changed = False
    self._model_version = 0
    self.model_fields: dict[str, TorchArray] = {}
    """Model fields that were asked for, and so may be written, by name."""
    self._watched: list[torch.Tensor] = []
    # Tensors of fields that were returned before their fields were expanded, with their version then.
    self._replaced: list[tuple[str, torch.Tensor, int]] = []

  def close(self, closed: Engine) -> None:
    """Replace the engine by `closed`, which refuses all calls. Every later read calls it."""
    self.engine = closed
    self.model_fields.clear()
    self._watched.clear()
    self.note_write()

  def check_mask(self, mask: torch.Tensor, what: str) -> None:
    """Raise MjlabError unless `mask` is bool, (num_envs,)."""
    if mask.shape != (self.num_envs,) or mask.dtype != torch.bool:
      raise MjlabError(f"{what}: mask must be bool of shape ({self.num_envs},), got {mask.dtype} {tuple(mask.shape)}")

  def refresh(self) -> None:
    """Recompute derived quantities if state or a model field was written since."""
    version = versions(self._watched)
    if version != self._model_version:
      self._model_version = version
      self.note_write(model=True)
      self._check_replaced()
    if versions(self._kinematic) != self._state_version:
      self.engine.forward(self._model_changed)
      self.settle()

  def settle(self) -> None:
    """Note that derived quantities were just computed."""
    self._state_version = versions(self._kinematic)
    self._model_changed = False
    self.version += 1

  def note_write(self, *, model: bool = False) -> None:
    """Note that the engine changed the state, or the model, without a write that version counters show."""
    self._model_changed |= model
    self._state_version = -1

  def state(self) -> dict[str, torch.Tensor]:
    """Return the fields of `STATE` that are not empty, as plain tensors."""
    fields = {name: plain(self.engine.data_field(name)) for name in STATE}
    return {name: field for name, field in fields.items() if field.numel()}

  def data_field(self, name: str) -> TorchArray:
    """Return a field of MjData; KeyError if the engine has no such field."""
    if name not in STATE:
      self.refresh()
    return self.engine.data_field(name)

  def model_field(self, name: str) -> TorchArray:
    """Return a per-world field of MjModel; KeyError if there is no such field."""
    field = self.model_fields.get(name)
    if field is None:
      field = self.model_fields[name] = self.engine.model_field(name)
      self._watched.append(plain(field))
      # Its memory may have been written before: only later writes count.
      self._model_version += version_of(field)
    return field

  def expand(self, names: Iterable[str]) -> None:
    """Give model fields one value per world. Tensors that were handed out before are watched for writes."""
    for name in names:
      if name in self.model_fields:
        shared = plain(self.model_fields[name])
        self._replaced.append((name, shared, version_of(shared)))
      self.engine.expand(name)
    self.model_fields = {name: self.engine.model_field(name) for name in self.model_fields}
    self._watched = [plain(field) for field in self.model_fields.values()]
    self._watched += [shared for _, shared, _ in self._replaced]
    # A write to the shared field may not have been seen yet.
    self.note_write(model=True)
    self._model_version = versions(self._watched)

  def _check_replaced(self) -> None:
    written = {name for name, shared, version in self._replaced if version_of(shared) != version}
    self._replaced = [(name, shared, version_of(shared)) for name, shared, _ in self._replaced]
    if written:
      raise MjlabError(
        f"model field {', '.join(sorted(written))} was written through a tensor from before it was expanded, which "
        "changes no world; take it from sim.model again"
      )


class DataView:
  """Fields of MjData as tensors, (num_envs, ...): `sim.data.qpos`. Matrices are (..., 3, 3).

  A name is assigned in place: `sim.data.ctrl = u` writes every world's controls.
  """

  _fresh: Freshness

  def __init__(self, fresh: Freshness) -> None:
    object.__setattr__(self, "_fresh", fresh)

  def __getitem__(self, name: str) -> TorchArray:
    try:
      return self._fresh.data_field(name)
    except KeyError:
      raise AttributeError(unknown("data field", name, _DATA_FIELDS)) from None

  def __getattr__(self, name: str) -> TorchArray:
    if name.startswith("__"):
      raise AttributeError(name)
    return self[name]

  def __setattr__(self, name: str, value: torch.Tensor) -> None:
    field = self[name]
    # `data.qpos += x` adds in place and then assigns the result to the name it came from.
    if value is not field:
      field.copy_(value)


class ModelView(DataView):
  """Fields of MjModel that may differ per world, as tensors: (1, ...) while shared, (num_envs, ...) once expanded.

  A name is assigned in place, too. A write to a shared field reaches every world.
  """

  _prefix: str

  def __init__(self, fresh: Freshness, prefix: str = "") -> None:
    super().__init__(fresh)
    object.__setattr__(self, "_prefix", prefix)

  def __getitem__(self, name: str) -> TorchArray:
    name = self._prefix + name
    if name not in PER_WORLD:
      others = "Others are the same in every world: read them from sim.mj_model."
      raise AttributeError(f"{unknown('per-world model field', name, sorted(PER_WORLD))} {others}")
    return self._fresh.model_field(name)

  @property
  def opt(self) -> "ModelView":
    """Options that may differ per world: `sim.model.opt.gravity`."""
    return ModelView(self._fresh, "opt.")
