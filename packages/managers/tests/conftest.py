"""An environment of nothing but numbers, and what the tests of the managers share."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

# The tests share a module.
sys.path.insert(0, str(Path(__file__).parent))

JOINTS = ("FL_hip", "FL_knee", "FR_hip", "FR_knee", "RL_hip")


@dataclass
class FakeEntity:
  joint_names: tuple[str, ...] = JOINTS
  body_names: tuple[str, ...] = ("trunk", "FL_foot")
  geom_names: tuple[str, ...] = ()
  site_names: tuple[str, ...] = ("imu",)
  actuator_names: tuple[str, ...] = JOINTS


@dataclass
class FakeScene:
  entities: dict[str, FakeEntity] = field(default_factory=lambda: {"robot": FakeEntity()})

  def __getitem__(self, name: str, /) -> FakeEntity:
    return self.entities[name]


class FakeEnv:
  """Satisfies `ManagerEnv`. `values` (N, 5) is what terms look at; the lists are what the managers asked for."""

  command_manager: Any = None
  reward_manager: Any = None

  def __init__(
    self, num_envs: int = 4, *, seed: int = 0, dtype: torch.dtype = torch.float32, device: str = "cpu"
  ) -> None:
    self.num_envs, self.device = num_envs, torch.device(device)
    self.physics_dt, self.step_dt = 0.005, 0.02
    self.max_episode_length, self.max_episode_length_s = 50, 1.0
    self.scene = FakeScene()
    self.rng = torch.Generator(device).manual_seed(seed)
    self.episode_length_buf = torch.ones(num_envs, dtype=torch.int64, device=device)
    self.common_step_counter = torch.zeros((), dtype=torch.int64, device=device)
    self.values = torch.arange(num_envs * 5, dtype=dtype, device=device).reshape(num_envs, 5)
    self.eager: list[str] = []
    self.recaptures: list[str] = []
    self.recomputed: list[list[int]] = []

  def run_eagerly(self, fn: Callable[[], None], name: str) -> None:
    self.eager.append(name)
    fn()

  def request_recapture(self, reason: str) -> None:
    self.recaptures.append(reason)

  def recompute_constants(self, mask: torch.Tensor) -> None:
    self.recomputed.append(mask.nonzero().flatten().tolist())

  def mask(self, *worlds: int) -> torch.Tensor:
    mask = torch.zeros(self.num_envs, dtype=torch.bool)
    mask[list(worlds)] = True
    return mask


class _Dispatched(TorchDispatchMode):
  def __init__(self) -> None:
    super().__init__()
    self.names: list[str] = []

  def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
    name = func.name()
    if name.startswith(("aten::index.", "aten::index_put", "aten::_index_put")):
      indices = [index for index in args[1] if index is not None]
      if any(index.dtype is torch.bool for index in indices):
        name = f"{name} (boolean index)"
    self.names.append(name)
    return func(*args, **(kwargs or {}))


# These ask the device something, or depend on how many worlds a mask holds.
SYNCS = ("_local_scalar_dense", "nonzero", "item", "masked_select", "aten::equal", "lift_fresh", "boolean index")


@pytest.fixture
def make_env() -> Callable[..., FakeEnv]:
  return FakeEnv


@pytest.fixture
def env() -> FakeEnv:
  return FakeEnv()


@pytest.fixture
def logged() -> Callable[[Any], dict[str, float]]:
  """What a manager would log now."""

  def read(manager: Any) -> dict[str, float]:
    names, values = manager.log_tensors()
    assert values.shape == (len(names),)
    return dict(zip(names, values.tolist(), strict=True))

  return read


@pytest.fixture
def dispatched() -> Callable[[Callable[[], Any]], list[str]]:
  """Names of the operations of a call, views left out; fails if one of them asks the device something."""

  def run(call: Callable[[], Any]) -> list[str]:
    call()
    with _Dispatched() as counter:
      call()
    bad = [name for name in counter.names if any(sync in name for sync in SYNCS)]
    assert not bad, f"these operations make the host wait: {bad}"
    views = ("select", "slice", "unsqueeze", "expand", "view", "unbind", "alias", "detach", "t.default")
    return [name for name in counter.names if not any(name.startswith(f"aten::{view}") for view in views)]

  return run


@pytest.fixture
def nothing_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
  """Run every part of a step for empty masks, too, as a GPU does."""
  for module in ("mjlab_managers.command_manager", "mjlab_managers.event_manager"):
    monkeypatch.setattr(f"{module}.call_where", lambda mask, fn, generator: fn(mask))
