"""What a physics engine offers to `Simulation`. Nothing above this seam knows which engine runs."""

from typing import Protocol

import torch

from mjlab_sim.contacts import EngineContacts
from mjlab_sim.rays import EngineRayCaster
from mjlab_sim.rendering import EngineRenderer, View
from mjlab_sim.static_rays import RayTargets
from mjlab_sim.torch_array import TorchArray


class Engine(Protocol):
  """Many worlds of one model on one device.

  Every call leaves the worlds it does not act on bit-identical. `mask` is a bool tensor (num_envs,) on the device, or
  None for all worlds.
  """

  dtype: torch.dtype
  """Precision of state and derived quantities."""

  def data_field(self, name: str) -> TorchArray:
    """A field of MjData, (num_envs, ...); KeyError if the engine has no such field."""
    ...

  def model_field(self, name: str) -> TorchArray:
    """A per-world field of MjModel: (1, ...) while shared, (num_envs, ...) once expanded."""
    ...

  def expand(self, name: str) -> None:
    """Give a model field one value per world, each the shared one."""
    ...

  def step(self) -> None:
    """Integrate the last half of a physics step and compute position and velocity stages at the new state."""
    ...

  def forward(self, model_changed: bool) -> None:
    """Compute position and velocity stages of every world that was written to, of all if the model changed."""
    ...

  def reset(self, mask: torch.Tensor) -> None:
    """Set masked worlds to the model's initial state; derived quantities are left to `forward`."""
    ...

  def recompute_constants(self, mask: torch.Tensor | None) -> None:
    """Recompute the derived model fields of masked worlds (`mj_setConst`)."""
    ...

  def ray_caster(self, targets: RayTargets, max_distance: float, geomid: bool) -> EngineRayCaster:
    """A caster with fixed outputs that sees `targets` up to `max_distance` [m]."""
    ...

  def renderer(self, view: View) -> EngineRenderer:
    """A renderer with fixed images."""
    ...

  def contacts(self) -> EngineContacts:
    """The record of contacts, which every step keeps from the first call on."""
    ...

  def count_overflow(self) -> None:
    """Add this moment's buffer overflows to the counters, on the device."""
    ...

  def overflow_report(self) -> list[str]:
    """One sentence for each buffer that overflowed since the last report, with the setting to raise. Reads the host."""
    ...

  def close(self) -> None:
    """Release threads and graphs."""
    ...
