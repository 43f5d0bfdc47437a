"""Entities, terrain and sensors composed into one MuJoCo scene."""

from mjlab_scene.collision import CollisionCfg
from mjlab_scene.entity import Entity
from mjlab_scene.entity_cfg import EntityArticulationCfg, EntityCfg, InitialStateCfg
from mjlab_scene.entity_data import EntityData
from mjlab_scene.indexing import EntityIndexing
from mjlab_scene.initial_state import InitialState
from mjlab_scene.keyframes import INIT_STATE
from mjlab_scene.scene import Scene, SceneCfg, TerrainCfg
from mjlab_scene.terrain_levels import TerrainLevels
from mjlab_scene.variants import VariantEntity, VariantEntityCfg

__all__ = [
  "INIT_STATE",
  "CollisionCfg",
  "Entity",
  "EntityArticulationCfg",
  "EntityCfg",
  "EntityData",
  "EntityIndexing",
  "InitialState",
  "InitialStateCfg",
  "Scene",
  "SceneCfg",
  "TerrainCfg",
  "TerrainLevels",
  "VariantEntity",
  "VariantEntityCfg",
]
