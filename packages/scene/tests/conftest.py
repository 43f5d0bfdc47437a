"""A scene in a simulation, in one call."""

from collections.abc import Callable, Iterator
from typing import Any, Literal

import mujoco
import pytest
import torch
from mjlab_scene import EntityCfg, Scene, SceneCfg
from mjlab_sim import Simulation, SimulationCfg

Worlds = tuple[Scene, Simulation]
MakeWorlds = Callable[..., Worlds]


@pytest.fixture
def make_worlds() -> Iterator[MakeWorlds]:
  """Builds a scene of entities, given as MJCF or EntityCfg, and its simulation."""
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
      cfg = SceneCfg(
        num_envs=num_envs,
        entities={
          name: EntityCfg(spec_fn=lambda text=entity: mujoco.MjSpec.from_string(text))
          if isinstance(entity, str)
          else entity
          for name, entity in entities.items()
        },
      )
    scene = Scene(cfg)
    sim_cfg = SimulationCfg(engine=engine, timestep=0.002, num_threads=1, **(sizes or {}))
    sim = Simulation(cfg.num_envs, scene.spec, sim_cfg, device="cpu")
    opened.append(sim)
    scene.initialize(sim, torch.Generator().manual_seed(0))
    return scene, sim

  yield make
  for sim in opened:
    sim.close()
