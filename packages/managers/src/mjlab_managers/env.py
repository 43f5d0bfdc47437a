"""What a manager needs of an environment, and nothing more."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import torch


class SceneLike(Protocol):
  """A collection of named entities and sensors; `scene["robot"]` is an entity."""

  @property
  def entities(self) -> Mapping[str, Any]:
    """Entities by name; each has `joint_names`, `body_names`, `geom_names`, `site_names`, `actuator_names`."""
    ...

  def __getitem__(self, name: str, /) -> Any: ...


class ManagerEnv(Protocol):
  """An environment as the managers see it: many worlds that step together on one device."""

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
  def scene(self) -> SceneLike: ...

  @property
  def rng(self) -> torch.Generator:
    """The one source of randomness of terms, on `device`."""
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
    """Runs `fn` outside the recorded step: splits the graph while it is recorded, a plain call otherwise."""
    ...

  def request_recapture(self, reason: str) -> None:
    """Asks for a new recording of the step before the next replay."""
    ...

  def recompute_constants(self, mask: torch.Tensor) -> None:
    """Recomputes the model quantities that derive from randomised fields, in the worlds of `mask`, bool (N,)."""
    ...
