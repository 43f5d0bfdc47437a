"""Terrain that adds itself to any MuJoCo model. NumPy and MuJoCo only."""

from mjlab_terrain.plane import PlaneCfg
from mjlab_terrain.terrain import Terrain, grid_origins

__all__ = ["PlaneCfg", "Terrain", "grid_origins"]
