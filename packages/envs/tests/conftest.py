"""Environments that close themselves."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg

# The tests share a module.
sys.path.insert(0, str(Path(__file__).parent))

from envs_hopper import hopper_cfg

# Tiny tensors: a second thread would only wait for the first.
torch.set_num_threads(1)


@pytest.fixture
def make() -> Iterator[Callable[..., ManagerBasedRlEnv]]:
  """An environment of the hopper, or of a config, after its first reset unless `begun` is False."""
  opened: list[ManagerBasedRlEnv] = []

  def build(
    cfg: ManagerBasedRlEnvCfg | None = None, device: str = "cpu", begun: bool = True, **options: Any
  ) -> ManagerBasedRlEnv:
    env = ManagerBasedRlEnv(hopper_cfg(**options) if cfg is None else cfg, device)
    opened.append(env)
    if begun:
      env.reset()
    return env

  yield build
  for env in opened:
    env.close()


@pytest.fixture(params=["native", pytest.param("warp", marks=pytest.mark.warp)])
def engine(request: pytest.FixtureRequest) -> str:
  """Either engine."""
  return request.param


@pytest.fixture
def nothing_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
  """Run every part of a step for empty masks, too, as a GPU does."""
  for module in ("mjlab_envs.env", "mjlab_managers.command_manager", "mjlab_managers.event_manager"):
    monkeypatch.setattr(f"{module}.call_where", lambda mask, fn, generator: fn(mask))
