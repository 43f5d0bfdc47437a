"""A scene in a simulation, in one call."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import pytest
import torch
from mjlab_scene import EntityCfg, Scene, SceneCfg
from mjlab_sim import Simulation, SimulationCfg

# The tests share a module.
sys.path.insert(0, str(Path(__file__).parent))

from scene_models import MakeWorlds, entity


@pytest.fixture
def make_worlds() -> Iterator[MakeWorlds]:
  """Build a scene of entities, given as MJCF or EntityCfg, and its simulation."""
  opened: list[Simulation] = []

  def make(
    num_envs: int = 2,
    engine: Literal["native", "warp"] = "native",
    *,
    cfg: SceneCfg | None = None,
    sizes: dict[str, Any] | None = None,
    **entities: EntityCfg | str,
  ):
    if cfg is None:
      built = {name: entity(given) if isinstance(given, str) else given for name, given in entities.items()}
      cfg = SceneCfg(num_envs=num_envs, entities=built)
    scene = Scene(cfg)
    sim_cfg = SimulationCfg(engine=engine, timestep=0.002, num_threads=1, **(sizes or {}))
    sim = Simulation(cfg.num_envs, scene.spec, sim_cfg, device="cpu")
    opened.append(sim)
    scene.initialize(sim, torch.Generator().manual_seed(0))
    return scene, sim

  yield make
  for sim in opened:
    sim.close()
