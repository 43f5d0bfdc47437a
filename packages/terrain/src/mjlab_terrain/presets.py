"""Sets of types of tile with useful settings."""

from __future__ import annotations

from mjlab_terrain.tile_cfg import TileCfg
from mjlab_terrain.types.boxes import FlatCfg, RandomBoxesCfg, RandomGridCfg, TiltedGridCfg
from mjlab_terrain.types.gaps import NarrowBeamsCfg, NestedRingsCfg, SteppingStonesCfg
from mjlab_terrain.types.heights import (
  DiscreteObstaclesCfg,
  PerlinNoiseCfg,
  PyramidSlopeCfg,
  RandomRoughCfg,
  WavesCfg,
)
from mjlab_terrain.types.stairs import OpenStairsCfg, PyramidStairsCfg, RandomStairsCfg


def all_types() -> dict[str, TileCfg]:
  """Return one of every type, by name, each from easy to hard for a robot with legs of half a metre."""
  return {
    "flat": FlatCfg(),
    "stairs_up": PyramidStairsCfg(),
    "stairs_down": PyramidStairsCfg(inverted=True),
    "open_stairs": OpenStairsCfg(),
    "random_stairs": RandomStairsCfg(),
    "random_grid": RandomGridCfg(),
    "random_boxes": RandomBoxesCfg(),
    "tilted_grid": TiltedGridCfg(tilt=(0.0, 20.0), height=(0.0, 0.3)),
    "stepping_stones": SteppingStonesCfg(size_variation=(0.0, 0.2)),
    "narrow_beams": NarrowBeamsCfg(),
    "nested_rings": NestedRingsCfg(),
    "slope_up": PyramidSlopeCfg(),
    "slope_down": PyramidSlopeCfg(inverted=True),
    "random_rough": RandomRoughCfg(),
    "waves": WavesCfg(),
    "discrete_obstacles": DiscreteObstaclesCfg(),
    "perlin_noise": PerlinNoiseCfg(),
  }


def walking_types() -> dict[str, TileCfg]:
  """Return a mix to learn walking on: level ground, stairs and slopes up and down, rough ground and waves."""
  return {
    "flat": FlatCfg(share=0.2),
    "stairs_up": PyramidStairsCfg(share=0.2),
    "stairs_down": PyramidStairsCfg(share=0.2, inverted=True),
    "slope_up": PyramidSlopeCfg(share=0.1),
    "slope_down": PyramidSlopeCfg(share=0.1, inverted=True),
    "random_rough": RandomRoughCfg(share=0.1),
    "waves": WavesCfg(share=0.1),
  }
