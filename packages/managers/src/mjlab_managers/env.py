"""Protocol of an environment, as managers use it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import torch


class ManagerEnv(Protocol):
  """Environment of many worlds that step together on one device."""

  @property
  def num_envs(self) -> int:
    """Number of worlds, called N in shapes."""
    ...

  @property
  def device(self) -> torch.device: ...

  @property
  def physics_dt(self) -> float:
    """Time of one physics substep [s]."""
    ...

  @property
  def step_dt(self) -> float:
    """Time of one environment step [s]."""
    ...

  @property
  def max_episode_length(self) -> int:
    """Steps after which an episode times out."""
    ...

  @property
  def max_episode_length_s(self) -> float:
    """Time after which an episode times out [s]."""
    ...

  @property
  def scene(self) -> Any:
    """Scene with named entities and sensors: `scene["robot"]`, and all entities by name in `scene.entities`.

    An entity has `joint_names`, `body_names`, `geom_names`, `site_names`, `actuator_names`.
    """
    ...

  @property
  def rng(self) -> torch.Generator:
    """Generator of all random draws of terms, on `device`."""
    ...

  @property
  def episode_length_buf(self) -> torch.Tensor:
    """Steps since each world's reset, int64 (N,)."""
    ...

  @property
  def common_step_counter(self) -> torch.Tensor:
    """Environment steps since build, int64, 0-d, on `device`."""
    ...

  def run_eagerly(self, fn: Callable[[], None], name: str) -> None:
    """Run `fn` outside the recorded step: split the graph during a recording, otherwise call `fn`."""
    ...

  def request_recapture(self, reason: str) -> None:
    """Request a new recording of the step before the next replay."""
    ...

  def recompute_constants(self, mask: torch.Tensor) -> None:
    """Recompute model quantities that derive from randomised fields, in the worlds of `mask`, bool (N,)."""
    ...
