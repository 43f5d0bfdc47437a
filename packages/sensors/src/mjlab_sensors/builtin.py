"""Sensors that MuJoCo computes itself: gyros, joint positions, frame poses and so on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Literal, get_args

import mujoco
import torch
from mjlab_core import DebugDraw, NameMatchError, quat_from_matrix, unknown

from mjlab_sensors._elements import find_element, names_of
from mjlab_sensors.native_types import NATIVE_TYPES
from mjlab_sensors.sensor import Sensor, SensorCfg, sensordata_columns

if TYPE_CHECKING:
  from mjlab_sim import Simulation

ObjKind = Literal["body", "xbody", "joint", "geom", "site", "actuator", "tendon", "camera", "mesh"]

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
  "camprojection",
  "insidesite",
  "distance",
  "normal",
  "fromto",
  "tactile",
]


RayDataField = Literal["dist", "dir", "origin", "point", "normal", "depth"]
_Obj = mujoco.mjtObj
# Where in the simulation's data what a sensor is attached to has its place and its axes.
_POSES: dict[int, tuple[str, str]] = {
  _Obj.mjOBJ_SITE: ("site_xpos", "site_xmat"),
  _Obj.mjOBJ_GEOM: ("geom_xpos", "geom_xmat"),
  _Obj.mjOBJ_CAMERA: ("cam_xpos", "cam_xmat"),
  _Obj.mjOBJ_XBODY: ("xpos", "xmat"),
  _Obj.mjOBJ_BODY: ("xipos", "ximat"),
}
# In the order in which MuJoCo lays them out for each ray.
_RAY_FIELDS: tuple[str, ...] = get_args(RayDataField)


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
  """Full name of an existing sensor element of the scene, such as `robot/imu_gyro`. Excludes all fields that describe a
  new one."""
  sensor_type: SensorType | None = None
  """What a new sensor measures."""
  obj: ObjRef | None = None
  """What a new sensor is attached to."""
  ref: ObjRef | None = None
  """What a new sensor is measured relative to: the frame of a frame sensor, which without one is the world's; the other
  side of a distance; the camera of a projection; the site that something is inside of; the geom that carries a mesh of
  taxels."""
  cutoff: float = 0.0
  """Readings are clamped to this magnitude, in the sensor's own unit; 0 for no limit. Of "distance", "normal" and
  "fromto" it is how far they see [m]; 0 sees penetration only."""
  ray_data: tuple[RayDataField, ...] = ("dist",)
  """What a rangefinder tells of each of its rays, one after the other in this order: distance [m], -1 where nothing is
  hit; direction; origin, hit point and normal in the world frame [m]; depth along the axis of a camera [m]."""
  enclosed: bool = False
  """Let "insidesite" tell how far an object reaches out of the site [m] instead of whether its frame is inside."""

  def validate(self) -> None:
    if self.element is not None:
      others = [field for field in fields(self) if field.name not in ("name", "debug_vis", "element")]
      if given := [field.name for field in others if getattr(self, field.name) != field.default]:
        raise ValueError(f"{self.label}: `element` wraps a sensor as it is; leave {', '.join(given)} out")
      return
    if self.sensor_type is None:
      raise ValueError(f"{self.label}: give `element`, a sensor that the scene has, or `sensor_type` for a new one")
    kind = NATIVE_TYPES.get(self.sensor_type)
    if kind is None:
      raise ValueError(unknown("sensor type", self.sensor_type, get_args(SensorType), self.label))
    if kind.declared_by != BuiltinSensorCfg.__name__:
      instead = f"it is declared by {kind.declared_by}" if kind.declared_by else "only an MJCF can declare it"
      raise ValueError(f"{self.label}: a {self.sensor_type} sensor cannot be declared here; {instead}")
    for field, ref, allowed in (("obj", self.obj, kind.objects), ("ref", self.ref, kind.references)):
      if ref is not None and ref.type not in allowed:
        takes = f"takes a {' or '.join(allowed)}" if allowed else "takes none"
        raise ValueError(f"{self.label}: a {self.sensor_type} sensor {takes} as `{field}`, not {ref.type} {ref.name!r}")
      if ref is None and allowed and (field == "obj" or kind.needs_reference):
        raise ValueError(f"{self.label}: a {self.sensor_type} sensor needs a {' or '.join(allowed)} as `{field}`")
    if not self.cutoff >= 0.0:
      raise ValueError(f"{self.label}: cutoff must be 0 (none) or positive, not {self.cutoff}")
    if self.sensor_type == "rangefinder":
      for name in self.ray_data:
        if name not in _RAY_FIELDS:
          raise ValueError(unknown("ray_data", name, _RAY_FIELDS, self.label))
      if list(self.ray_data) != [name for name in _RAY_FIELDS if name in self.ray_data] or not self.ray_data:
        raise ValueError(f"{self.label}: ray_data must keep the order {_RAY_FIELDS}, but is {self.ray_data}")
    elif self.ray_data != ("dist",):
      raise ValueError(f"{self.label}: ray_data is a rangefinder's, not a {self.sensor_type} sensor's")
    if self.enclosed and self.sensor_type != "insidesite":
      raise ValueError(f"{self.label}: enclosed is for insidesite, not for a {self.sensor_type} sensor")

  def _make(self, name: str) -> BuiltinSensor:
    return BuiltinSensor(name, self)


class BuiltinSensor(Sensor[torch.Tensor]):
  """A sensor computed by MuJoCo; `data` are its columns of the simulation's sensordata, (num_envs, dim).

  Frame and unit of each type are in `NATIVE_TYPES`. Noise and delay are the observation manager's.
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
    sensor = spec.add_sensor(name=self._element, type=NATIVE_TYPES[cfg.sensor_type].enum, cutoff=cfg.cutoff)
    if cfg.sensor_type == "rangefinder":
      sensor.intprm[0] = sum(1 << _RAY_FIELDS.index(name) for name in cfg.ray_data)
    elif cfg.enclosed:
      sensor.intprm[0] = 1
    if cfg.obj is not None:
      sensor.objtype = getattr(mujoco.mjtObj, f"mjOBJ_{cfg.obj.type.upper()}")
      sensor.objname = cfg.obj.resolve(spec, entities, self.label)
    if cfg.ref is not None:
      sensor.reftype = getattr(mujoco.mjtObj, f"mjOBJ_{cfg.ref.type.upper()}")
      sensor.refname = cfg.ref.resolve(spec, entities, self.label)

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    self._columns = sim.data.sensordata[:, sensordata_columns(sim, self._element, self.label)]

  def debug_draw(self, draw: DebugDraw) -> None:
    """Show where the sensor is, and the direction of a reading that has one."""
    sim, worlds = self.sim, list(draw.worlds)
    model = sim.mj_model
    index = model.sensor(self._element).id
    field = _POSES.get(int(model.sensor_objtype[index]))
    if field is None:
      return
    _ = sim.epoch
    place, turn = (getattr(sim.data, name)[worlds, int(model.sensor_objid[index])] for name in field)
    draw.frames(place, quat_from_matrix(turn), 3.0 * self._draw_size)
    kind = next(kind for kind in NATIVE_TYPES.values() if kind.enum.value == model.sensor_type[index])
    has_direction = kind.dim == 3 and kind.unit != "m" and kind.frame in ("own", "world", "reference")
    if not has_direction or (kind.frame == "reference" and model.sensor_refid[index] >= 0):
      return
    vector = self._columns[worlds]
    if kind.frame == "own":
      vector = (turn * vector[:, None]).sum(-1)
    vector = vector / vector.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    draw.arrows(place, place + 5.0 * self._draw_size * vector, (1.0, 1.0, 0.0, 1.0), 0.2 * self._draw_size)

  def _read(self) -> torch.Tensor:
    return self._columns
