"""Bases of all sensors: their life cycle, and data that are computed once per state of the simulation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, TypeVar

import mujoco
import torch
from mjlab_core import (
  Config,
  DebugDraw,
  Items,
  Limits,
  MjlabError,
  Stateful,
  check_fields,
)

if TYPE_CHECKING:
  from mjlab_sim import Simulation

T = TypeVar("T")
GeomGroups = Annotated[tuple[int, ...] | None, Limits(ge=0, le=mujoco.mjNGROUP - 1), Items(ge=1)]


@dataclass(kw_only=True)
class SensorCfg(Config):
  """Configuration of a sensor."""

  sensor_class: ClassVar[type[Sensor[Any]]]
  """Class of the sensor, which gives itself as `class MySensor(Sensor, cfg=MySensorCfg)`."""
  name: str = ""
  """Name of the sensor in its scene; empty for the name that the scene passes to `build`."""
  debug_vis: bool = False
  """Draw the sensor in a viewer from the start."""

  def __post_init__(self) -> None:
    self.validate()

  def validate(self) -> None:
    """Raise ConfigError for values that are wrong in every scene. Runs when the config is made and at `build`."""
    check_fields(self, self.label, self.problems())

  def problems(self) -> Iterator[str]:
    """Yield the mistakes in fields that fit their annotations."""
    yield from ()

  @property
  def label(self) -> str:
    """The sensor as error messages call it."""
    return f"{type(self).__name__} '{self.name}'" if self.name else type(self).__name__

  def build(self, name: str = "") -> Sensor[Any]:
    """Return the sensor, not yet part of any spec.

    Args:
      name: name in the scene; needed only if the configuration has none.

    Raises:
      MjlabError: the configuration is wrong, or it has no name, or two different ones.
    """
    if (not name and not self.name) or (name and self.name not in ("", name)):
      raise MjlabError(f"{self.label}: needs one name; the scene calls this sensor {name!r}")
    # The copy is checked again, with the name in messages.
    return self.sensor_class(replace(self, name=name or self.name))


class Sensor(Stateful, ABC, Generic[T]):
  """Reading of a simulation.

  A scene calls, in this order: `edit_spec` before the model is compiled, `initialize` once there is a simulation, then
  `update` after every substep and `reset` for the worlds that restart. Terms read `data`; a viewer calls `debug_draw`
  once per picture.
  """

  decimation: int | None = None
  """Physics steps of one environment step, set by the environment before `edit_spec`; None without an environment."""
  rng: torch.Generator | None = None
  """Source of randomness on the simulation's device, set before `initialize`; torch's own if None."""

  def __init_subclass__(cls, cfg: type[SensorCfg] | None = None) -> None:
    super().__init_subclass__()
    if cfg is not None:
      cfg.sensor_class = cls

  def __init__(self, cfg: Any) -> None:
    self.cfg, self.name, self.label = cfg, cfg.name, cfg.label
    self.num_envs = 0
    self._sim: Simulation | None = None
    self._read_at: tuple[int, int] | None = None
    self._reading: T | None = None

  @abstractmethod
  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    """Check every name against the spec, and add what the sensor needs to it.

    Args:
      spec: the scene, with all entities attached; elements of entity `robot` are named `robot/...`.
      entities: the scene's entities by name; only their names are read.

    Raises:
      MjlabError: a name or pattern matches nothing, with the nearest names.
    """

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    """Allocate all memory and keep a reference to the simulation, which runs the model compiled from the spec."""
    del entities
    self.num_envs, self.device = sim.num_envs, sim.device
    self._sim = sim
    self._read_at = None

  def update(self, dt: float) -> None:
    """Process the last substep of `dt` [s]. The default does nothing."""
    del dt

  def reset(self, mask: torch.Tensor) -> None:
    """Forget the past of the worlds in `mask`, (num_envs,) bool. The default does nothing."""
    del mask

  def debug_draw(self, draw: DebugDraw) -> None:
    """Draw the reading of the worlds in `draw.worlds`. The default draws nothing."""
    del draw

  @property
  def _draw_size(self) -> float:
    """Size of a small drawing in this model [m]."""
    return 0.5 * float(self.sim.mj_model.stat.meansize)

  def _draw_direction(self, draw: DebugDraw, place: torch.Tensor, vector: torch.Tensor) -> None:
    """Draw the direction of world vectors at places, both (n, 3)."""
    unit = vector / vector.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    draw.arrows(place, place + 5.0 * self._draw_size * unit, (1.0, 1.0, 0.0, 1.0), 0.2 * self._draw_size)

  @property
  def data(self) -> T:
    """Reading for the present state.

    It is computed at the first access after a change of state, so it is never stale and a second access costs nothing.
    The tensors are the sensor's own memory: do not write them, and clone them to keep them for longer than the step.
    """
    now = self.sim.version, self._version()
    if now != self._read_at or self._reading is None:
      self._reading = self._read()
      self._read_at = now
    return self._reading

  @property
  def sim(self) -> Simulation:
    """Simulation that the sensor reads.

    Raises:
      RuntimeError: `initialize` has not been called.
    """
    if self._sim is None:
      raise RuntimeError(f"{self.label}: not initialized; call `initialize` with the scene's simulation first")
    return self._sim

  def _version(self) -> int:
    """Return a number that changes with each write of the sensor's own memory."""
    return 0

  @abstractmethod
  def _read(self) -> T:
    """Compute the reading; all derived quantities of the simulation are current."""


def group_mask(groups: tuple[int, ...] | None) -> list[bool] | None:
  """Return a mask of MuJoCo's geom groups; None for all."""
  return None if groups is None else [group in groups for group in range(mujoco.mjNGROUP)]


def sensordata_columns(sim: Simulation, name: str) -> slice:
  """Return the columns of the native sensor `name` in `sim.data.sensordata`; KeyError if the model has none."""
  sensor = sim.mj_model.sensor(name)
  start = int(sensor.adr[0])
  return slice(start, start + int(sensor.dim[0]))
