"""Interface of a physics engine. Nothing above this seam knows which engine runs."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import torch
from mjlab_core import Contacts, MjlabError

from mjlab_sim.rays import Rays, RayTargets
from mjlab_sim.rendering import Draw, View
from mjlab_sim.tensors import TorchArray


class Engine(Protocol):
  """Many worlds of one model on one device.

  Every call leaves the worlds it does not act on bit-identical. `mask` is a bool tensor (num_envs,) on the device, or
  None for all worlds.
  """

  dtype: torch.dtype
  """Precision of state and derived quantities."""

  def data_field(self, name: str) -> TorchArray:
    """Return a field of MjData, (num_envs, ...); KeyError if the engine has no such field."""
    ...

  def model_field(self, name: str) -> TorchArray:
    """Return a per-world field of MjModel: (1, ...) while shared, (num_envs, ...) once expanded."""
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

  def ray_caster(self, targets: RayTargets, rays: Rays) -> Callable[[bool], None]:
    """Return a function that casts `rays`. Its argument is True if all fixed geoms are in their compiled places."""
    ...

  def renderer(self, view: View, images: Mapping[str, torch.Tensor]) -> Draw:
    """Return a function that draws a view into `images`."""
    ...

  def contacts(self, world: int) -> Contacts[torch.Tensor]:
    """Return the contacts of a world in the last step; every step keeps them from the first call on.

    There are none before the step after the first call, and none after a reset.
    """
    ...

  def overflow_report(self) -> list[str]:
    """Return one line with the settings to raise when the demand outgrows the last advice. Reads the device."""
    ...

  @property
  def buffer_sizes(self) -> dict[str, int]:
    """Room for contacts (`nconmax`) and constraint rows (`njmax`) of each world; empty if nothing limits them."""
    ...

  def make_room(self, at_least: Mapping[str, int]) -> bool:
    """Give buffers more room if they are nearly full or smaller than `at_least`; return True if one has new memory.

    Contacts and constraints are then left to `forward`. All else stays where it is. A GPU is not waited for otherwise.
    """
    ...


class Closed:
  """Engine of a simulation that is closed; it refuses every call."""

  def __getattr__(self, name: str) -> Any:
    raise MjlabError("this simulation is closed")
