"""Worlds on the tiles of a terrain: where they begin, how they are promoted, what is saved."""

import pytest
import torch
from mjlab_scene import Scene, SceneCfg, TerrainLevels
from mjlab_sim import Simulation
from mjlab_terrain import FlatCfg, PyramidStairsCfg, TerrainGridCfg

NUM_ENVS = 24


def grid() -> TerrainGridCfg:
  types = {"flat": FlatCfg(share=0.25), "stairs": PyramidStairsCfg(share=0.75)}
  return TerrainGridCfg(rows=4, types=types, border_width=0.0, light=False)


def build(max_init_level: int | None = 1, seed: int = 0) -> tuple[Scene, TerrainLevels]:
  scene = Scene(SceneCfg(num_envs=NUM_ENVS, terrain=grid(), max_init_terrain_level=max_init_level))
  sim = Simulation(NUM_ENVS, scene.spec)
  scene.initialize(sim, torch.Generator().manual_seed(seed))
  assert scene.terrain_levels is not None
  return scene, scene.terrain_levels


def every_world(value: bool = True) -> torch.Tensor:
  return torch.full((NUM_ENVS,), value)


def test_worlds_begin_on_easy_rows_of_columns_by_their_share() -> None:
  scene, levels = build()
  assert set(levels.levels.tolist()) == {0, 1}
  assert levels.column_types == ("flat", "stairs")
  assert torch.bincount(levels.columns).tolist() == [6, 18]
  assert scene.terrain is not None
  expected = torch.tensor(scene.terrain.origins)[levels.levels, levels.columns]
  torch.testing.assert_close(scene.env_origins, expected)


def test_a_promoted_world_moves_up_one_row_and_the_others_stay_bit_identical() -> None:
  scene, levels = build(max_init_level=0)
  before = scene.env_origins.clone()
  mask, up = every_world(False), every_world()
  mask[3] = True
  levels.move(mask, up, every_world(False))
  assert levels.levels[3] == 1
  assert scene.env_origins[3, 0] > before[3, 0]
  assert torch.equal(scene.env_origins[~mask], before[~mask])
  levels.move(mask, every_world(False), up)
  assert torch.equal(scene.env_origins, before)


def test_no_world_falls_below_the_easiest_row_and_above_the_hardest_rows_are_drawn() -> None:
  _, levels = build()
  for _ in range(5):
    levels.move(every_world(), every_world(False), every_world())
  assert not levels.levels.any()
  seen = set()
  for _ in range(40):
    levels.move(every_world(), every_world(), every_world(False))
    seen |= set(levels.levels.tolist())
  assert seen == {0, 1, 2, 3}


def test_randomizing_touches_masked_worlds_alone() -> None:
  scene, levels = build()
  before = scene.env_origins.clone()
  mask = torch.arange(NUM_ENVS) % 2 == 0
  levels.randomize(mask)
  assert not torch.equal(scene.env_origins[mask], before[mask])
  assert torch.equal(scene.env_origins[~mask], before[~mask])


def test_tiles_of_worlds_are_saved_and_restored() -> None:
  scene, levels = build(seed=0)
  levels.randomize(every_world())
  other, other_levels = build(seed=1)
  other.load_state_dict(scene.state_dict())
  assert torch.equal(other_levels.levels, levels.levels)
  assert torch.equal(other_levels.columns, levels.columns)
  assert torch.equal(other.env_origins, scene.env_origins)


def test_a_row_that_does_not_exist_is_refused() -> None:
  with pytest.raises(ValueError, match=r"max_init_terrain_level must be in \[0, 3\], got 4"):
    build(max_init_level=4)
