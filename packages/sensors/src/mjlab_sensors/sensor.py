"""What all sensors share: their life cycle, and data that are computed once per state of the simulation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import mujoco
import torch
from mjlab_core import DebugDraw, Stateful

if TYPE_CHECKING:
  from mjlab_sim import Simulation

T = TypeVar("T")


@dataclass(kw_only=True)
class SensorCfg(ABC):
  """Configuration of a sensor."""

  name: str = ""
  """Name of the sensor in its scene. May be left to the scene, which passes its own key to `build`."""
  debug_vis: bool = False
  """Whether viewers draw the sensor at first."""

  def __post_init__(self) -> None:
    self.validate()

  def validate(self) -> None:  # noqa: B027 - a sensor without rules of its own is fine
    """Raise ValueError for what is wrong whatever the scene. Runs when made, and again at `build`."""

  @property
  def label(self) -> str:
    """The sensor as error messages call it."""
    return f"{type(self).__name__} '{self.name}'" if self.name else type(self).__name__

  def build(self, name: str = "") -> Sensor[Any]:
    """The sensor, not yet part of any spec.

    Args:
      name: the name it has in its scene; needed only where the configuration does not give one.

    Raises:
      ValueError: the configuration is wrong, or it has no name, or two different ones.
    """
    if name and self.name and name != self.name:
      raise ValueError(f"{self.label}: the scene calls this sensor {name!r}; give one name, or leave `name` empty")
    if not (name or self.name):
      raise ValueError(f"{type(self).__name__}: a sensor needs a name")
    # By its name, which messages give.
    replace(self, name=name or self.name).validate()
    return self._make(name or self.name)

  @abstractmethod
  def _make(self, name: str) -> Sensor[Any]: ...


class Sensor(Stateful, ABC, Generic[T]):
  """Something that is read from a simulation.

  A scene calls, in this order: `edit_spec` before the model is compiled, `initialize` once there is a simulation, then
  `update` after every substep and `reset` for the worlds that start anew. Whoever wants the reading asks `data`; a
  viewer calls `debug_draw` once a picture.
  """

  _constants = frozenset({"_reading"})

  decimation: int | None = None
  """Physics steps of one environment step, for what follows it; whoever knows sets it before `edit_spec`."""
  rng: torch.Generator | None = None
  """Source of randomness on the simulation's device, set before `initialize`; torch's own if None."""

  def __init__(self, name: str, cfg: SensorCfg) -> None:
    self.name = name
    self.cfg = cfg
    self.num_envs = 0
    self._sim: Simulation | None = None
    self._read_at: tuple[int, int] | None = None
    self._reading: T | None = None

  @property
  def label(self) -> str:
    """The sensor as error messages call it."""
    return f"{type(self.cfg).__name__} '{self.name}'"

  @abstractmethod
  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    """Check every name against the spec, and add what the sensor needs to it.

    Args:
      spec: the scene, with all entities attached; elements of entity `robot` are named `robot/...`.
      entities: the scene's entities by name; only their names are read.

    Raises:
      ValueError: a name or pattern matches nothing, with the nearest names.
    """

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    """Allocate all memory and take hold of the simulation, which runs the model compiled from the edited spec."""
    del entities
    self.num_envs = sim.num_envs
    self._sim = sim
    self._read_at = None

  def update(self, dt: float) -> None:
    """Take note of the substep just done, of `dt` [s]. By default there is nothing to note."""
    del dt

  def reset(self, mask: torch.Tensor) -> None:
    """Forget the past of the worlds in `mask`, (num_envs,) bool. By default there is none."""
    del mask

  def debug_draw(self, draw: DebugDraw) -> None:
    """Show what is sensed in the worlds of `draw.worlds`. By default there is nothing to show."""
    del draw

  @property
  def _draw_size(self) -> float:
    """Size of a small thing in this model's picture [m]."""
    return 0.5 * float(self.sim.mj_model.stat.meansize)

  @property
  def data(self) -> T:
    """The reading for the state as it is now.

    It is computed at the first access after anything that it depends on has changed, so it is never stale and a second
    access costs nothing. The tensors are the sensor's own memory: read them, do not write them, and clone what
    must outlive the step.
    """
    now = self.sim.epoch, self._version()
    if now != self._read_at or self._reading is None:
      self._reading = self._read()
      self._read_at = now
    return self._reading

  @property
  def sim(self) -> Simulation:
    """The simulation that is read.

    Raises:
      RuntimeError: `initialize` has not been called.
    """
    if self._sim is None:
      raise RuntimeError(f"{self.label}: not initialized; it can be read once its scene has a simulation")
    return self._sim

  def _version(self) -> int:
    """A number that changes when memory of the sensor's own is written that its reading follows from."""
    return 0

  @abstractmethod
  def _read(self) -> T:
    """Compute the reading; everything derived in the simulation is fresh."""


def sensordata_columns(sim: Simulation, name: str, owner: str) -> slice:
  """Where the native sensor `name` lies in `sim.data.sensordata`.

  Raises:
    ValueError: the simulation's model has no such sensor.
  """
  model = sim.mj_model
  index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
  if index < 0:
    raise ValueError(f"{owner}: the simulation's model has no sensor {name!r}; was it compiled before `edit_spec`?")
  start = int(model.sensor_adr[index])
  return slice(start, start + int(model.sensor_dim[index]))
