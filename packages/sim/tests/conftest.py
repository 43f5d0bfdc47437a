"""Simulations of one small model, on either engine."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import pytest
import torch
from mjlab_sim import Simulation, SimulationCfg

# The tests share a module.
sys.path.insert(0, str(Path(__file__).parent))

from sim_world import NUM_WORLDS, SIZES, WORLD, MakeSim

# Tiny tensors: a second thread would only wait for the first.
torch.set_num_threads(1)


@pytest.fixture
def make_sim() -> Iterator[MakeSim]:
  """A simulation of `WORLD` on a CPU; closed after the test."""
  opened: list[Simulation] = []

  def make(engine: str = "native", num_envs: int = NUM_WORLDS, spec: str = WORLD, **options: Any) -> Simulation:
    settings: dict[str, Any] = {"engine": engine, "num_threads": 1, **SIZES, **options}
    cfg = SimulationCfg(**settings)
    sim = Simulation(num_envs, mujoco.MjSpec.from_string(spec), cfg, "cpu")
    opened.append(sim)
    return sim

  yield make
  for sim in opened:
    sim.close()


@pytest.fixture(params=["native", pytest.param("warp", marks=pytest.mark.warp)])
def engine(request: pytest.FixtureRequest) -> str:
  """Either engine."""
  return request.param


@pytest.fixture
def sim(make_sim: MakeSim, engine: str) -> Simulation:
  """Simulation of `WORLD` on either engine."""
  return make_sim(engine)
