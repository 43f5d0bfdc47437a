"""Sensors that MuJoCo computes itself: gyros, joint positions, frame poses and so on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import mujoco
import torch
from mjlab_core import NameMatchError, unknown

from mjlab_sensors._elements import find_element, names_of
from mjlab_sensors.sensor import Sensor, SensorCfg, sensordata_columns

if TYPE_CHECKING:
  from mjlab_sim import Simulation

ObjKind = Literal["body", "xbody", "joint", "geom", "site", "actuator", "tendon", "camera"]

SensorType = Literal[
  "accelerometer",
  "velocimeter",
  "gyro",
  "force",
  "torque",
  "touch",
  "magnetometer",
  "rangefinder",
  "jointpos",
  "jointvel",
  "jointlimitpos",
  "jointlimitvel",
  "jointlimitfrc",
  "jointactuatorfrc",
  "ballquat",
  "ballangvel",
  "tendonpos",
  "tendonvel",
  "tendonlimitpos",
  "tendonlimitvel",
  "tendonlimitfrc",
  "tendonactuatorfrc",
  "actuatorpos",
  "actuatorvel",
  "actuatorfrc",
  "framepos",
  "framequat",
  "framexaxis",
  "frameyaxis",
  "framezaxis",
  "framelinvel",
  "frameangvel",
  "framelinacc",
  "frameangacc",
  "subtreecom",
  "subtreelinvel",
  "subtreeangmom",
  "e_potential",
  "e_kinetic",
  "clock",
]


class _Kind(NamedTuple):
  objects: tuple[str, ...]
  """What it can be attached to; nothing for a sensor of the whole world."""
  references: tuple[str, ...] = ()
  """What it can be measured relative to."""
  enum: str = ""
  """Name in `mujoco.mjtSensor` where it differs from the sensor's name."""


# A rangefinder may report more than the distance; this bit asks for that alone.
_DISTANCE = 1 << mujoco.mjtRayDataField.mjRAYDATA_DIST.value
_FRAMES = ("body", "xbody", "geom", "site", "camera")


def _kind(sensor_type: str) -> _Kind:
  match sensor_type:
    case "accelerometer" | "velocimeter" | "gyro" | "force" | "torque" | "touch" | "magnetometer" | "rangefinder":
      return _Kind(("site",))
    case "jointactuatorfrc":
      return _Kind(("joint",), enum="JOINTACTFRC")
    case "tendonactuatorfrc":
      return _Kind(("tendon",), enum="TENDONACTFRC")
    case "framelinacc" | "frameangacc":
      return _Kind(_FRAMES)
    case "e_potential" | "e_kinetic" | "clock":
      return _Kind(())
  if sensor_type.startswith(("joint", "ball")):
    return _Kind(("joint",))
  if sensor_type.startswith("tendon"):
    return _Kind(("tendon",))
  if sensor_type.startswith("actuator"):
    return _Kind(("actuator",))
  if sensor_type.startswith("subtree"):
    return _Kind(("body",))
  return _Kind(_FRAMES, _FRAMES)


@dataclass(kw_only=True, frozen=True)
class ObjRef:
  """One element of the scene, by exact name."""

  type: ObjKind
  """What it is. A "body" is seen at its centre of mass, in its inertial axes; an "xbody" at its frame."""
  name: str
  entity: str | None = None
  """Entity whose element it is; without one, `name` is the full name in the scene."""

  def __post_init__(self) -> None:
    if self.type not in get_args(ObjKind):
      raise ValueError(unknown("type of object", self.type, get_args(ObjKind), f"ObjRef '{self.name}'"))

  def resolve(self, spec: mujoco.MjSpec, entities: Mapping[str, Any], owner: str) -> str:
    """Its full name in the scene; NameMatchError if there is no such element."""
    return find_element(spec, entities, self.type, self.name, entity=self.entity, owner=owner)


@dataclass(kw_only=True)
class BuiltinSensorCfg(SensorCfg):
  """A sensor computed by MuJoCo: one that the MJCF already has (`element`), or a new one (`sensor_type`, `obj`)."""

  element: str | None = None
  """Full name of an existing sensor element of the scene, such as `robot/imu_gyro`. Excludes all other fields."""
  sensor_type: SensorType | None = None
  """What a new sensor measures."""
  obj: ObjRef | None = None
  """What a new sensor is attached to."""
  ref: ObjRef | None = None
  """Frame that a frame sensor is measured in; without one, the world."""
  cutoff: float = 0.0
  """Readings are clamped to this magnitude, in the sensor's own unit; 0 for no limit."""

  def validate(self) -> None:
    if self.element is not None:
      if self.sensor_type is not None or self.obj is not None or self.ref is not None or self.cutoff:
        raise ValueError(f"{self.label}: `element` wraps a sensor as it is; leave sensor_type, obj, ref and cutoff out")
      return
    if self.sensor_type is None:
      raise ValueError(f"{self.label}: give `element`, a sensor that the scene has, or `sensor_type` for a new one")
    if self.sensor_type not in get_args(SensorType):
      raise ValueError(unknown("sensor type", self.sensor_type, get_args(SensorType), self.label))
    kind = _kind(self.sensor_type)
    for field, ref, allowed in (("obj", self.obj, kind.objects), ("ref", self.ref, kind.references)):
      if ref is not None and ref.type not in allowed:
        takes = f"takes a {' or '.join(allowed)}" if allowed else "takes none"
        raise ValueError(f"{self.label}: a {self.sensor_type} sensor {takes} as `{field}`, not {ref.type} {ref.name!r}")
    if kind.objects and self.obj is None:
      raise ValueError(f"{self.label}: a {self.sensor_type} sensor needs a {' or '.join(kind.objects)} as `obj`")
    if self.cutoff < 0.0:
      raise ValueError(f"{self.label}: cutoff must be 0 (none) or positive, not {self.cutoff}")

  def _make(self, name: str) -> BuiltinSensor:
    return BuiltinSensor(name, self)


class BuiltinSensor(Sensor[torch.Tensor]):
  """A sensor computed by MuJoCo; `data` are its columns of the simulation's sensordata, (num_envs, dim).

  What depends on positions and velocities describes the present state. What depends on accelerations and forces
  (accelerometer, force, torque, touch, actuator forces of joints, frame accelerations) describes the substep
  just done, and is zero in worlds just reset.
  """

  _constants = frozenset({"_columns"})
  cfg: BuiltinSensorCfg

  def __init__(self, name: str, cfg: BuiltinSensorCfg) -> None:
    super().__init__(name, cfg)
    self._element = name if cfg.element is None else cfg.element
    self._columns = torch.empty(0)

  @property
  def dim(self) -> int:
    """Number of values in each world."""
    return self._columns.shape[-1]

  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    cfg, existing = self.cfg, names_of(spec, "sensor")
    if cfg.sensor_type is None:
      if self._element not in existing:
        raise NameMatchError(unknown("sensor element", self._element, existing, self.label))
      return
    if self._element in existing:
      raise ValueError(
        f"{self.label}: the scene already has a sensor element of this name; "
        f"use BuiltinSensorCfg(element={self._element!r}), or another name"
      )
    enum = _kind(cfg.sensor_type).enum or cfg.sensor_type.upper()
    sensor = spec.add_sensor(name=self._element, type=getattr(mujoco.mjtSensor, f"mjSENS_{enum}"), cutoff=cfg.cutoff)
    if cfg.sensor_type == "rangefinder":
      sensor.intprm[0] = _DISTANCE
    if cfg.obj is not None:
      sensor.objtype = getattr(mujoco.mjtObj, f"mjOBJ_{cfg.obj.type.upper()}")
      sensor.objname = cfg.obj.resolve(spec, entities, self.label)
    if cfg.ref is not None:
      sensor.reftype = getattr(mujoco.mjtObj, f"mjOBJ_{cfg.ref.type.upper()}")
      sensor.refname = cfg.ref.resolve(spec, entities, self.label)

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    self._columns = sim.data.sensordata[:, sensordata_columns(sim, self._element, self.label)]

  def _read(self) -> torch.Tensor:
    return self._columns
