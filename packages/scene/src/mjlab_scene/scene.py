"""Terrain, entities and sensors as one model, and the part of a step that belongs to them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import mujoco
import numpy as np
import torch
from mjlab_core.counts import why_no_count
from mjlab_core.names import UnknownNameError, unknown
from mjlab_core.state import Stateful
from mjlab_sensors import BuiltinSensorCfg, Sensor, SensorCfg
from mjlab_terrain import Terrain, grid_origins

from mjlab_scene.entity import Entity
from mjlab_scene.entity_cfg import EntityCfg
from mjlab_scene.keyframes import add_init_state
from mjlab_scene.looks import new_scene_spec
from mjlab_scene.options import OptionMerger
from mjlab_scene.terrain_levels import TerrainLevels

if TYPE_CHECKING:
  from mjlab_sim import Simulation

TERRAIN = "terrain"
"""Name under which a scene lists its terrain."""


class TerrainCfg(Protocol):
  """What a scene needs of a terrain's configuration."""

  def add_to(self, spec: mujoco.MjSpec) -> Terrain:
    """Add the terrain to `spec`."""
    ...


@dataclass(kw_only=True)
class SceneCfg:
  """What the worlds of a simulation contain. Building a scene leaves its configuration as it is."""

  num_envs: int = 1
  """Number of worlds."""
  env_spacing: float = 2.0
  """Distance between the origins of neighbouring worlds [m]; worlds share one coordinate system but never touch."""
  terrain: TerrainCfg | None = None
  """Ground, added without prefix."""
  max_init_terrain_level: int | None = None
  """Hardest row of a terrain of tiles that worlds begin on; None for all rows."""
  entities: dict[str, EntityCfg] = field(default_factory=dict)
  """Entities by name; their elements are called "<name>/..." in the scene."""
  sensors: dict[str, SensorCfg] = field(default_factory=dict)
  """Sensors by name, beside those that the entities' models bring."""
  extent: float | None = None
  """Size of what a viewer shows at first [m]; None lets MuJoCo find it."""
  spec_fn: Callable[[mujoco.MjSpec], None] | None = None
  """Last edit of the assembled spec."""


class Scene(Stateful):
  """Everything in the worlds of one simulation.

  Built from its configuration it is a spec; `initialize` ties it to the simulation of that spec. `scene["robot"]` is an
  entity, a sensor or, under "terrain", the terrain. Sensors that an entity's model brings are read as
  `scene["robot/imu_gyro"]` unless a configured sensor claims them.

  Args:
    cfg: What the worlds contain.
    decimation: Physics steps of one environment step, for sensors that follow it; None where there is no such thing.

  Raises:
    ValueError: anything wrong in the configuration, by name.
  """

  _children = ("entities", "sensors", "terrain_levels")

  env_origins: torch.Tensor
  """Where each world has its origin, world frame, (num_envs, 3) [m]; there once the scene is initialized."""

  def __init__(self, cfg: SceneCfg, decimation: int | None = None) -> None:
    if wrong := why_no_count(cfg.num_envs, 1):
      raise ValueError(f"scene: num_envs {wrong}")
    if cfg.extent is not None and not 0.0 < cfg.extent < math.inf:
      raise ValueError(f"scene: extent must be a positive length, got {cfg.extent}")
    self.cfg = cfg
    self.num_envs = cfg.num_envs
    self.spec = new_scene_spec()
    """The assembled model; a simulation compiles it."""
    if cfg.extent is not None:
      self.spec.stat.extent = cfg.extent
    self.terrain: Terrain | None = None if cfg.terrain is None else cfg.terrain.add_to(self.spec)
    """What the terrain says of itself; None without one."""
    self.terrain_levels: TerrainLevels | None = None
    """Which tile each world stands on, once initialized; None on a plane."""
    origins = grid_origins if self.terrain is None else self.terrain.env_origins
    self._origins: np.ndarray = origins(cfg.num_envs, cfg.env_spacing)
    for name in (*cfg.entities, *cfg.sensors):
      if name == TERRAIN:
        raise ValueError(f"scene: '{TERRAIN}' is the terrain's name; call this entity or sensor something else")
      if name in cfg.entities and name in cfg.sensors:
        raise ValueError(f"scene: '{name}' is both an entity and a sensor; scene['{name}'] can only be one of them")
    self.entities: dict[str, Entity] = self._attach_entities()
    """Entities by name."""
    self.sensors: dict[str, Sensor[Any]] = self._add_sensors(decimation)
    """Sensors by name."""
    if cfg.spec_fn is not None:
      cfg.spec_fn(self.spec)
    by_prefix = {entity.prefix: entity for entity in self.entities.values()}
    add_init_state(
      self.spec,
      {prefix: entity.initial_state for prefix, entity in by_prefix.items()},
      {prefix: prefix + entity.root_body_name for prefix, entity in by_prefix.items()},
    )

  def _attach_entities(self) -> dict[str, Entity]:
    options = OptionMerger(self.spec)
    entities = {name: cfg.build(name) for name, cfg in self.cfg.entities.items()}
    # Options of all first: an attached spec must agree with the scene when it comes in and when the scene is compiled.
    for name, entity in entities.items():
      options.adopt(entity.spec, f"entity '{name}'")
    for name, entity in entities.items():
      options.adopt(entity.spec, f"entity '{name}'")
      entity.attach(self.spec)
    # What is compiled as simple cannot be given another centre of mass.
    for body in self.spec.bodies[1:]:
      body.simple = False
    return entities

  def _add_sensors(self, decimation: int | None) -> dict[str, Sensor[Any]]:
    found = [sensor.name for sensor in self.spec.sensors if sensor.name]
    claimed = {getattr(cfg, "element", None) for cfg in self.cfg.sensors.values()}
    sensors: dict[str, Sensor[Any]] = {}
    for name, cfg in self.cfg.sensors.items():
      if name in found and getattr(cfg, "element", None) != name:
        raise ValueError(f"scene: sensor '{name}' exists already: an entity's model brings it; choose another name")
      sensors[name] = cfg.build(name)
    for name in found:
      if name not in claimed and name not in sensors:
        sensors[name] = BuiltinSensorCfg(element=name).build(name)
    for sensor in sensors.values():
      sensor.decimation = decimation
      sensor.edit_spec(self.spec, self.entities)
    return sensors

  def compile(self) -> mujoco.MjModel:
    """The model of one world, with the keyframe "init_state"."""
    return self.spec.compile()

  def initialize(self, sim: Simulation, rng: torch.Generator | None = None) -> None:
    """Tie the scene to the simulation made from `spec`, and put every world into its initial state.

    Args:
      sim: Has as many worlds as the scene.
      rng: Source of randomness on the simulation's device.
    """
    if sim.num_envs != self.num_envs:
      raise ValueError(f"scene: the simulation has {sim.num_envs} worlds, the scene {self.num_envs}")
    self.env_origins = torch.tensor(self._origins, dtype=sim.dtype, device=sim.device)
    if self.terrain is not None and math.isfinite(self.terrain.tile_size[0]):
      rng = torch.Generator(sim.device).manual_seed(0) if rng is None else rng
      self.terrain_levels = TerrainLevels(self.terrain, self.env_origins, self.cfg.max_init_terrain_level, rng)
    for entity in self.entities.values():
      entity.initialize(sim, rng=rng)
    for sensor in self.sensors.values():
      sensor.rng = rng
      sensor.initialize(sim, self.entities)
    everywhere = torch.ones(self.num_envs, dtype=torch.bool, device=sim.device)
    self.reset(everywhere)
    self.write_default_state()

  # Running

  def write_ctrl(self) -> None:
    """Turn the entities' set-points into controls; once before each substep."""
    for entity in self.entities.values():
      entity.write_ctrl()

  def update(self, dt: float) -> None:
    """Let the sensors take note of the substep just done, of `dt` [s]."""
    for sensor in self.sensors.values():
      sensor.update(dt)

  def reset(self, mask: torch.Tensor) -> None:
    """Forget the past of masked worlds (num_envs,): set-points, delays, sensors. After the simulation's own reset.

    Bases that do not float go to their place in each world. The rest of the state is left to whoever resets it.
    """
    for entity in self.entities.values():
      entity.reset(mask)
    self.place_fixed_bases(mask)
    for sensor in self.sensors.values():
      sensor.reset(mask)

  def place_fixed_bases(self, mask: torch.Tensor) -> None:
    """Put bases that do not float to their place in masked worlds (num_envs,), whose origins may have moved."""
    for entity in self.entities.values():
      if not entity.is_floating:
        entity.write_default_root_state(self.env_origins, mask)

  def write_default_state(self, mask: torch.Tensor | None = None) -> None:
    """Put every entity of masked worlds into its initial state at the world's origin; None means all worlds."""
    for entity in self.entities.values():
      entity.write_default_state(self.env_origins, mask)

  # Access

  def __getitem__(self, name: str) -> Any:
    """The entity, sensor or terrain of this name; UnknownNameError lists the names there are."""
    if name in self.entities:
      return self.entities[name]
    if name in self.sensors:
      return self.sensors[name]
    if name == TERRAIN and self.terrain is not None:
      return self.terrain
    raise UnknownNameError(unknown("entity or sensor", name, list(self), "scene"))

  def __contains__(self, name: object) -> bool:
    return name in list(self)

  def __iter__(self) -> Iterator[str]:
    """Names of all entities and sensors, and "terrain" if there is one."""
    yield from self.entities
    yield from self.sensors
    if self.terrain is not None:
      yield TERRAIN

  def __len__(self) -> int:
    return len(list(iter(self)))

  def keys(self) -> list[str]:
    """Names that the scene can be asked for."""
    return list(self)
