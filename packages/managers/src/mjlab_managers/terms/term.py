"""Terms: functions with parameters, or classes with parameters and state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import torch
from mjlab_core import Config, Stateful


@dataclass
class ManagerTermBaseCfg(Config):
  """Config of a term: a function or class, and its parameters."""

  func: Callable[..., Any]
  """Function or other callable `f(env, *, ...)`, or a subclass of `ManagerTermBase`."""
  _: KW_ONLY
  params: dict[str, Any] = field(default_factory=dict)
  """Parameters by name. Every SceneEntityCfg in it is resolved, at any depth."""


class ManagerTermBase(Stateful):
  """Base of class terms, which take their parameters at build and may have state.

      class swing_height(ManagerTermBase):
        def __init__(self, env, *, sensor: str, target: float) -> None:
          super().__init__(env)
          self._sensor, self._target = env.scene[sensor], target
          self.peak = self.state((4,))

        def __call__(self) -> torch.Tensor: ...

  Events and curricula are called with the worlds to act on, `__call__(self, mask)`.

  Parameters annotated `float` are passed as 0-d tensors, so that `set_params` is a write. float(x) returns a Python
  number.
  """

  name: str = ""
  """Name of the term in its manager, set before `__init__` runs."""

  def __init__(self, env: Any) -> None:
    self.env = env
    self.num_envs: int = env.num_envs
    self.device: torch.device = env.device

  def reset(self, mask: torch.Tensor) -> None:
    """Begin new episodes in the worlds of `mask`, bool (num_envs,). The default refills their declared state."""
    self.refill(mask)
