"""An environment of nothing but numbers, for the tests of the managers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import torch

JOINTS = ("FL_hip", "FL_knee", "FR_hip", "FR_knee", "RL_hip")


@dataclass
class FakeEntity:
  joint_names: tuple[str, ...] = JOINTS
  body_names: tuple[str, ...] = ("trunk", "FL_foot")
  geom_names: tuple[str, ...] = ()
  site_names: tuple[str, ...] = ("imu",)
  actuator_names: tuple[str, ...] = JOINTS
  data: Any = None


@dataclass
class FakeScene:
  entities: dict[str, FakeEntity] = field(default_factory=lambda: {"robot": FakeEntity()})

  def __getitem__(self, name: str, /) -> FakeEntity:
    return self.entities[name]


class FakeEnv:
  """Satisfies `ManagerEnv`; `values` (N, 5) is what terms look at, and `log` is what the managers asked of it."""

  def __init__(self, num_envs: int = 4, *, seed: int = 0, dtype: torch.dtype = torch.float32) -> None:
    self.num_envs, self.device = num_envs, torch.device("cpu")
    self.physics_dt, self.step_dt = 0.005, 0.02
    self.max_episode_length, self.max_episode_length_s = 50, 1.0
    self.scene = FakeScene()
    self.rng = torch.Generator().manual_seed(seed)
    self.episode_length_buf = torch.zeros(num_envs, dtype=torch.int64)
    self.common_step_counter = torch.zeros((), dtype=torch.int64)
    self.values = torch.arange(num_envs * 5, dtype=dtype).reshape(num_envs, 5)
    self.eager: list[str] = []
    self.recaptures: list[str] = []
    self.recomputed: list[torch.Tensor] = []
    self.managers: Mapping[str, Any] = {}
    self.command_manager: Any = None
    self.reward_manager: Any = None

  def run_eagerly(self, fn: Callable[[], None], name: str) -> None:
    self.eager.append(name)
    fn()

  def request_recapture(self, reason: str) -> None:
    self.recaptures.append(reason)

  def recompute_constants(self, mask: torch.Tensor) -> None:
    self.recomputed.append(mask.clone())

  def mask(self, *worlds: int) -> torch.Tensor:
    mask = torch.zeros(self.num_envs, dtype=torch.bool)
    mask[list(worlds)] = True
    return mask


def logged(manager: Any) -> dict[str, float]:
  """What a manager would log now."""
  names, values = manager.log_tensors()
  return dict(zip(names, values.tolist(), strict=True))


__all__ = ["JOINTS", "FakeEntity", "FakeEnv", "FakeScene", "SimpleNamespace", "logged"]
