"""Terms: a function and its parameters, or a class when it remembers something."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import torch
from mjlab_core.state import Stateful

from mjlab_managers.env import ManagerEnv


@dataclass
class ManagerTermBaseCfg:
  """A term: what is called, and with what."""

  func: Callable[..., Any]
  """Function, partial or callable, or a class made once with `(cfg, env)` and then called with the same arguments."""
  _: KW_ONLY
  params: dict[str, Any] = field(default_factory=dict)
  """Arguments of `func` by name. Every SceneEntityCfg in it, however deep, is resolved."""


class ManagerTermBase(Stateful):
  """Base of class terms: `__init__(cfg, env)`, `__call__(env, ...)` and `reset(mask)`.

  `num_envs`, `device` and `name` exist before `__init__` runs, which need not call this one. Tensor attributes with one
  row per world are saved with the run.
  """

  num_envs: int
  device: torch.device
  name: str
  """The term's name in its manager (the class name while `__init__` runs)."""

  def __new__(cls, *args: Any, **kwargs: Any) -> ManagerTermBase:
    self = super().__new__(cls)
    self.name = cls.__name__
    env: ManagerEnv | None = kwargs.get("env", args[1] if len(args) > 1 else None)
    # Without arguments it is a copy being made, whose attributes follow.
    if env is not None:
      self.num_envs, self.device = env.num_envs, env.device
    return self

  def __init__(self, cfg: Any, env: Any) -> None:
    del cfg, env

  def reset(self, mask: torch.Tensor) -> None:
    """Forgets what belongs to the episodes of the worlds in `mask`, bool (N,)."""
    del mask
