"""Terrain that adds itself to any MuJoCo model. NumPy, MuJoCo and Pillow only."""

from mjlab_terrain.checked_fields import drawn, number, scaled
from mjlab_terrain.grid import TerrainGridCfg
from mjlab_terrain.patches import FlatPatchCfg
from mjlab_terrain.plane import PlaneCfg
from mjlab_terrain.presets import all_types, walking_types
from mjlab_terrain.terrain import Terrain, grid_origins
from mjlab_terrain.tile import Tile
from mjlab_terrain.tile_cfg import TileCfg
from mjlab_terrain.types.boxes import FlatCfg, RandomBoxesCfg, RandomGridCfg, TiltedGridCfg
from mjlab_terrain.types.gaps import NarrowBeamsCfg, NestedRingsCfg, SteppingStonesCfg
from mjlab_terrain.types.height_map import HeightMapCfg
from mjlab_terrain.types.heights import (
  DiscreteObstaclesCfg,
  PerlinNoiseCfg,
  PyramidSlopeCfg,
  RandomRoughCfg,
  WavesCfg,
)
from mjlab_terrain.types.mesh import MeshCfg
from mjlab_terrain.types.stairs import OpenStairsCfg, PyramidStairsCfg, RandomStairsCfg

__all__ = [
  "DiscreteObstaclesCfg",
  "FlatCfg",
  "FlatPatchCfg",
  "HeightMapCfg",
  "MeshCfg",
  "NarrowBeamsCfg",
  "NestedRingsCfg",
  "OpenStairsCfg",
  "PerlinNoiseCfg",
  "PlaneCfg",
  "PyramidSlopeCfg",
  "PyramidStairsCfg",
  "RandomBoxesCfg",
  "RandomGridCfg",
  "RandomRoughCfg",
  "RandomStairsCfg",
  "SteppingStonesCfg",
  "Terrain",
  "TerrainGridCfg",
  "Tile",
  "TileCfg",
  "TiltedGridCfg",
  "WavesCfg",
  "all_types",
  "drawn",
  "grid_origins",
  "number",
  "scaled",
  "walking_types",
]
