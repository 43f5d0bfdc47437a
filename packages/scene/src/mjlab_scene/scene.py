"""Terrain, entities and sensors as one model, and the part of a step that belongs to them."""

from __future__ import annotations

import math
from collections import ChainMap
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import mujoco
import numpy as np
import torch
from mjlab_core import (
  Config,
  Count,
  MjlabError,
  NonNegative,
  Positive,
  PositiveCount,
  Stateful,
  StatefulDict,
  UnknownNameError,
  check_fields,
  unknown,
)
from mjlab_core.errors import as_consequence
from mjlab_sensors import BuiltinSensorCfg, Sensor, SensorCfg
from mjlab_terrain import Terrain, grid_origins

from mjlab_scene.entities.entity import Entity, EntityCfg
from mjlab_scene.entities.initial_state import add_init_state
from mjlab_scene.export import write_spec, zip_spec
from mjlab_scene.models.edits import SpecEdit, apply_edits
from mjlab_scene.scene_spec import merge_options, new_scene_spec
from mjlab_scene.terrain_levels import TerrainLevels

if TYPE_CHECKING:
  from mjlab_sim import Simulation

TERRAIN = "terrain"
"""Name under which a scene lists its terrain."""


class TerrainCfg(Protocol):
  """Configuration of a terrain, as a scene uses it."""

  def add_to(self, spec: mujoco.MjSpec) -> Terrain:
    """Add the terrain to `spec`."""
    ...


@dataclass(kw_only=True)
class SceneCfg(Config):
  """Contents of the worlds of a simulation. Building a scene does not change its configuration."""

  num_envs: PositiveCount = 1
  """Number of worlds."""
  env_spacing: NonNegative = 2.0
  """Distance between the origins of neighbouring worlds [m]; worlds share one coordinate system but never touch."""
  terrain: TerrainCfg | None = None
  """Ground, added without prefix."""
  max_init_terrain_level: Count | None = None
  """Hardest row of a terrain of tiles that worlds begin on; None for all rows."""
  entities: dict[str, EntityCfg] = field(default_factory=dict)
  """Entities by name; their elements are called "<name>/..." in the scene."""
  sensors: dict[str, SensorCfg] = field(default_factory=dict)
  """Sensors by name, in addition to those of the entities' models."""
  extent: Positive | None = None
  """Size of the region that a viewer shows at first [m]; None lets MuJoCo compute it."""
  edits: tuple[SpecEdit, ...] = ()
  """Changes and additions of textures, materials, meshes, lights and cameras, after all parts are in."""
  spec_fn: Callable[[mujoco.MjSpec], None] | None = None
  """Last edit of the assembled spec."""


class Scene(Stateful):
  """Everything in the worlds of one simulation.

  A new scene is a spec; `initialize` ties it to the simulation of that spec. `scene["robot"]` is an
  entity, a sensor or, under "terrain", the terrain. Sensors in the model of an entity are read as
  `scene["robot/imu_gyro"]` unless a configured sensor claims them.

  Args:
    cfg: Contents of the worlds.
    decimation: Physics steps of one environment step, for sensors that need it; None without an environment.
    problems: List that receives one line per mistake in the terrain, an entity or a sensor; the scene is then made of
      the others. None raises the first.

  Raises:
    MjlabError: The configuration has a mistake; the message names it.
  """

  env_origins: torch.Tensor
  """Origin of each world, world frame, (num_envs, 3) [m]; exists once the scene is initialized."""

  def __init__(self, cfg: SceneCfg, decimation: int | None = None, *, problems: list[str] | None = None) -> None:
    check_fields(cfg, "scene")
    self._problems, self.missing = problems, set[str]()
    """Names of the parts that have a mistake and are left out."""
    self.cfg = cfg
    self.num_envs = cfg.num_envs
    self.spec = new_scene_spec()
    """The assembled model; a simulation compiles it."""
    if cfg.extent is not None:
      self.spec.stat.extent = cfg.extent
    self.terrain: Terrain | None = None
    """Facts about the terrain; None without one."""
    with self._attempt(TERRAIN):
      self.terrain = None if cfg.terrain is None else cfg.terrain.add_to(self.spec)
    self.terrain_levels: TerrainLevels | None = None
    """Tile of each world, once initialized; None on a plane."""
    origins = grid_origins if self.terrain is None else self.terrain.env_origins
    self._origins: np.ndarray = origins(cfg.num_envs, cfg.env_spacing)
    names = (TERRAIN, *cfg.entities, *cfg.sensors)
    if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
      raise MjlabError(f"scene: '{twice[0]}' names two parts ('{TERRAIN}' is the terrain's); rename one of them")
    self.entities: dict[str, Entity] = StatefulDict(self._attach_entities())
    """Entities by name."""
    self.sensors: dict[str, Sensor[Any]] = StatefulDict(self._add_sensors(decimation))
    """Sensors by name."""
    terrain = {} if self.terrain is None else {TERRAIN: self.terrain}
    self._parts = ChainMap[str, Any](terrain, self.sensors, self.entities)
    apply_edits(self.spec, cfg.edits, "scene")
    if cfg.spec_fn is not None:
      cfg.spec_fn(self.spec)
    # A body compiled as simple cannot get another centre of mass, joint anchor or joint axis.
    for body in self.spec.bodies[1:]:
      body.simple = False
    add_init_state(self.spec, {entity.prefix: entity.initial_state for entity in self.entities.values()})

  def _attach_entities(self) -> dict[str, Entity]:
    entities: dict[str, Entity] = {}
    for name, cfg in self.cfg.entities.items():
      with self._attempt(name):
        entities[name] = cfg.build(name)
    # Before the first is attached: an attached spec must agree with the scene then, and when the scene is compiled.
    merge_options(self.spec, {entity.owner: entity.spec for entity in entities.values()})
    for entity in entities.values():
      entity.attach(self.spec)
    return entities

  def _add_sensors(self, decimation: int | None) -> dict[str, Sensor[Any]]:
    found = [sensor.name for sensor in self.spec.sensors if sensor.name]
    claimed = {getattr(cfg, "element", None) for cfg in self.cfg.sensors.values()}
    sensors: dict[str, Sensor[Any]] = {}
    for name, cfg in self.cfg.sensors.items():
      if name in found and getattr(cfg, "element", None) != name:
        raise MjlabError(f"scene: sensor '{name}' exists already in an entity's model; choose another name")
      with self._attempt(name):
        sensors[name] = cfg.build(name)
    for name in found:
      if name not in claimed and name not in sensors:
        sensors[name] = BuiltinSensorCfg(element=name).build(name)
    for name, sensor in list(sensors.items()):
      sensor.decimation = decimation
      with self._attempt(name, sensors):
        sensor.edit_spec(self.spec, self.entities)
    return sensors

  @contextmanager
  def _attempt(self, name: str, parts: dict[str, Any] | None = None) -> Generator[None]:
    """Note the mistake of a part if mistakes are collected, and remove the part from `parts`."""
    try:
      yield
    except ValueError as error:
      if self._problems is None:
        raise
      # A sensor of an entity with a mistake has a mistake too.
      if not any(f"'{other}" in str(error) for other in self.missing):
        self._problems.append(str(error))
      self.missing.add(name)
      if parts is not None:
        del parts[name]

  def compile(self) -> mujoco.MjModel:
    """Return the model of one world, with the keyframe "init_state"."""
    return self.spec.compile()

  def write(self, folder: str | Path) -> Path:
    """Write the model as MJCF with its files into a folder, which replaces an existing one; return the MJCF's path."""
    return write_spec(self.spec.copy(), Path(folder))

  def to_zip(self, path: str | Path) -> Path:
    """Write the model as MJCF with its files into a zip archive; return its path."""
    return zip_spec(self.spec.copy(), Path(path))

  def initialize(self, sim: Simulation, rng: torch.Generator | None = None) -> None:
    """Tie the scene to the simulation made from `spec`, and put every world into its initial state.

    Args:
      sim: Has as many worlds as the scene.
      rng: Source of randomness on the simulation's device.
    """
    self.env_origins = self.state_of(torch.tensor(self._origins, dtype=sim.dtype, device=sim.device))
    if self.terrain is not None and math.isfinite(self.terrain.tile_size[0]):
      rng = torch.Generator(sim.device).manual_seed(0) if rng is None else rng
      self.terrain_levels = TerrainLevels(self.terrain, self.env_origins, self.cfg.max_init_terrain_level, rng)
    for name, entity in list(self.entities.items()):
      with self._attempt(name, self.entities):
        entity.initialize(sim, rng=rng)
    self._actuated = [entity.actuation for entity in self.entities.values() if entity.is_actuated]
    for name, sensor in list(self.sensors.items()):
      sensor.rng = rng
      with self._attempt(name, self.sensors):
        sensor.initialize(sim, self.entities)
    everywhere = torch.ones(self.num_envs, dtype=torch.bool, device=sim.device)
    self.reset(everywhere)
    self.write_default_state()

  # Running

  def write_ctrl(self) -> None:
    """Turn the entities' targets into controls; once before each substep."""
    for actuation in self._actuated:
      actuation.write_ctrl()

  def update(self, dt: float) -> None:
    """Update the sensors after a substep of `dt` [s]."""
    for sensor in self.sensors.values():
      sensor.update(dt)

  def reset(self, mask: torch.Tensor) -> None:
    """Reset targets, delays and sensors of masked worlds (num_envs,). Call it after the reset of the simulation.

    Bases that do not float are placed in each world. The rest of the state does not change.
    """
    for entity in self.entities.values():
      entity.reset(mask)
    self.place_fixed_bases(mask)
    for sensor in self.sensors.values():
      sensor.reset(mask)

  def place_fixed_bases(self, mask: torch.Tensor) -> None:
    """Place bases that do not float in masked worlds (num_envs,), whose origins may have moved."""
    for entity in self.entities.values():
      if not entity.is_floating:
        entity.write_default_root_state(self.env_origins, mask)

  def write_default_state(self, mask: torch.Tensor | None = None) -> None:
    """Put every entity of masked worlds into its initial state at the world's origin; None means all worlds."""
    for entity in self.entities.values():
      entity.write_default_state(self.env_origins, mask)

  # Access

  def __getitem__(self, name: str) -> Any:
    """Return the entity, sensor or terrain of this name; UnknownNameError lists the existing names."""
    if name in self._parts:
      return self._parts[name]
    error = UnknownNameError(unknown("entity or sensor", name, list(self), "scene"))
    raise as_consequence(error) if {name, name.split("/")[0]} & self.missing else error

  def __contains__(self, name: object) -> bool:
    return name in self._parts

  def __iter__(self) -> Iterator[str]:
    """Names of all entities and sensors, and "terrain" if there is one."""
    return iter(self._parts)
