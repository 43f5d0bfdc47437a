"""Entities, terrain and sensors composed into one MuJoCo scene."""

from mjlab_scene.entities.actuation import Quantity
from mjlab_scene.entities.entity import Entity, EntityArticulationCfg, EntityCfg
from mjlab_scene.entities.entity_data import EntityData
from mjlab_scene.entities.indexing import ColumnView, EntityIndexing
from mjlab_scene.entities.initial_state import INIT_STATE, InitialState, InitialStateCfg
from mjlab_scene.models.collision import CollisionCfg
from mjlab_scene.models.edits import CameraCfg, GeomCfg, LightCfg, MaterialCfg, MeshCfg, SpecEdit, TextureCfg
from mjlab_scene.models.overlay import Overlay, read_overlay
from mjlab_scene.models.variants import VariantEntity, VariantEntityCfg
from mjlab_scene.scene import Scene, SceneCfg, TerrainCfg
from mjlab_scene.terrain_levels import TerrainLevels

__all__ = [
  "INIT_STATE",
  "CameraCfg",
  "CollisionCfg",
  "ColumnView",
  "Entity",
  "EntityArticulationCfg",
  "EntityCfg",
  "EntityData",
  "EntityIndexing",
  "GeomCfg",
  "InitialState",
  "InitialStateCfg",
  "LightCfg",
  "MaterialCfg",
  "MeshCfg",
  "Overlay",
  "Quantity",
  "Scene",
  "SceneCfg",
  "SpecEdit",
  "TerrainCfg",
  "TerrainLevels",
  "TextureCfg",
  "VariantEntity",
  "VariantEntityCfg",
  "read_overlay",
]
