"""The fields of a simulation under their names."""

from typing import TYPE_CHECKING

import torch
from mjlab_core.names import unknown

from mjlab_sim.fields import PER_WORLD, STATE
from mjlab_sim.torch_array import TorchArray

if TYPE_CHECKING:
  from mjlab_sim.simulation import Simulation

_DATA_FIELDS = (
  *STATE,
  *"""qacc xpos xquat xmat xipos ximat geom_xpos geom_xmat site_xpos site_xmat cam_xpos cam_xmat subtree_com cvel
  subtree_linvel subtree_angmom sensordata actuator_force actuator_length actuator_velocity qfrc_actuator qfrc_bias
  qfrc_passive qfrc_constraint qfrc_smooth ten_length ten_velocity xanchor xaxis nefc energy""".split(),
)


class DataView:
  """Fields of MjData as tensors, (num_envs, ...): `sim.data.qpos`. Matrices are (..., 3, 3).

  A name is assigned in place: `sim.data.ctrl = u` writes every world's controls.
  """

  _sim: "Simulation"

  def __init__(self, sim: "Simulation") -> None:
    object.__setattr__(self, "_sim", sim)

  def __getattr__(self, name: str) -> TorchArray:
    sim = self._sim
    if name.startswith("__"):
      raise AttributeError(name)
    sim._check_open()
    if name not in STATE:
      sim._refresh()
    try:
      return sim._engine.data_field(name)
    except KeyError:
      raise AttributeError(unknown("data field", name, _DATA_FIELDS)) from None

  def __setattr__(self, name: str, value: torch.Tensor) -> None:
    field = getattr(self, name)
    # `data.qpos += x` adds in place and then assigns the result to the name it came from.
    if value is not field:
      field.copy_(value)


class ModelView:
  """Fields of MjModel that may differ per world, as tensors: (1, ...) while shared, (num_envs, ...) once expanded.

  A name is assigned in place. A write to a shared field reaches every world.
  """

  _sim: "Simulation"
  _prefix: str

  def __init__(self, sim: "Simulation", prefix: str = "") -> None:
    object.__setattr__(self, "_sim", sim)
    object.__setattr__(self, "_prefix", prefix)

  def __getattr__(self, name: str) -> TorchArray:
    if name.startswith("__"):
      raise AttributeError(name)
    return self[name]

  def __getitem__(self, name: str) -> TorchArray:
    try:
      return self._sim._model_field(self._prefix + name)
    except KeyError:
      raise AttributeError(
        unknown("per-world model field", self._prefix + name, sorted(PER_WORLD))
        + " Others are the same in every world: read them from sim.mj_model."
      ) from None

  def __setattr__(self, name: str, value: torch.Tensor) -> None:
    field = self[name]
    if value is not field:
      field.copy_(value)

  @property
  def opt(self) -> "ModelView":
    """Options that may differ per world: `sim.model.opt.gravity`."""
    return ModelView(self._sim, "opt.")
