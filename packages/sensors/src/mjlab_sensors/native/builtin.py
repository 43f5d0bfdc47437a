"""Sensors that MuJoCo computes itself: gyros, joint positions, frame poses and so on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import mujoco
import torch
from mjlab_core import Config, DebugDraw, Items, Limits, check_fields, check_name, quat_from_matrix

from mjlab_sensors.frames import POSES
from mjlab_sensors.native._elements import add_sensor, names_of, names_within
from mjlab_sensors.native.native_types import NATIVE_TYPES
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
# In the order in which MuJoCo lays them out for each ray.
_RAY_FIELDS = get_args(RayDataField)


@dataclass(kw_only=True, frozen=True)
class ObjRef(Config):
  """One element of the scene, by exact name."""

  type: ObjKind
  """Kind of element. A "body" is measured at its centre of mass, in its inertial axes; an "xbody" at its frame."""
  name: str
  entity: str | None = None
  """Entity of the element; without one, `name` is the full name in the scene."""

  def __post_init__(self) -> None:
    check_fields(self, f"ObjRef '{self.name}'")

  def resolve(self, spec: mujoco.MjSpec, entities: Mapping[str, Any], owner: str) -> str:
    """Return the full name in the scene; raise UnknownNameError if the element does not exist."""
    prefix, candidates = names_within(spec, entities, self.type, self.entity, owner)
    return prefix + check_name(self.type, self.name, candidates, owner)


@dataclass(kw_only=True)
class BuiltinSensorCfg(SensorCfg):
  """Sensor computed by MuJoCo: one that the MJCF already has (`element`), or a new one (`sensor_type`, `obj`)."""

  element: str | None = None
  """Full name of an existing sensor element of the scene, such as `robot/imu_gyro`. Excludes all fields that describe a
  new one."""
  sensor_type: SensorType | None = None
  """Quantity that a new sensor measures."""
  obj: ObjRef | None = None
  """Element that a new sensor is attached to."""
  ref: ObjRef | None = None
  """Element that a new sensor is measured relative to: the frame of a frame sensor, by default the world's; the other
  side of a distance; the camera of a projection; the site of "insidesite"; the geom with a mesh of taxels."""
  cutoff: Annotated[float, Limits(ge=0, finite=False)] = 0.0
  """Readings are clamped to this magnitude, in the sensor's own unit; 0 for no limit. It is the range of "distance",
  "normal" and "fromto" [m]; with 0 they measure penetration only."""
  ray_data: Annotated[tuple[RayDataField, ...], Items(ge=1)] = ("dist",)
  """Quantities that a rangefinder measures for each of its rays, in this order: distance [m], -1 without a hit;
  direction; origin, hit point and normal in the world frame [m]; depth along the axis of a camera [m]."""
  enclosed: bool = False
  """True: "insidesite" measures how far an object reaches out of the site [m]. False: it measures if the object's frame
  is inside."""

  def problems(self) -> Iterator[str]:
    if self.element is not None:
      others = [field for field in fields(self) if field.name not in ("name", "debug_vis", "element")]
      if given := [field.name for field in others if getattr(self, field.name) != field.default]:
        yield f"`element` names an existing sensor; leave {', '.join(given)} out"
      return
    kind = NATIVE_TYPES.get(self.sensor_type or "")
    if kind is None:
      yield "give `element`, a sensor of the scene, or `sensor_type` for a new one"
      return
    yield from self._object_problems("obj", self.obj, kind.objects, needed=True)
    yield from self._object_problems("ref", self.ref, kind.references, needed=kind.needs_reference)
    for field, owner in (("ray_data", "rangefinder"), ("enclosed", "insidesite")):
      if self.sensor_type != owner and getattr(self, field) != getattr(BuiltinSensorCfg, field):
        yield f"{field} requires sensor_type='{owner}', got {self.sensor_type!r}"
    if tuple(self.ray_data) != tuple(name for name in _RAY_FIELDS if name in self.ray_data):
      yield f"ray_data must keep the order {_RAY_FIELDS}, got {self.ray_data}"

  def _object_problems(
    self, field: str, ref: ObjRef | None, allowed: tuple[str, ...], *, needed: bool
  ) -> Iterator[str]:
    kinds = " or ".join(allowed)
    if ref is None and needed and allowed:
      yield f"a {self.sensor_type} sensor needs a {kinds} as `{field}`"
    if ref is not None and ref.type not in allowed:
      takes = f"takes a {kinds}" if allowed else "takes none"
      yield f"a {self.sensor_type} sensor {takes} as `{field}`, not {ref.type} {ref.name!r}"


class BuiltinSensor(Sensor[torch.Tensor], cfg=BuiltinSensorCfg):
  """Sensor computed by MuJoCo; `data` are its columns of the simulation's sensordata, (num_envs, dim).

  Frame and unit of each type are in `NATIVE_TYPES`. Noise and delay belong to the observation manager. Readings that
  depend on positions and velocities describe the present state. Readings that depend on accelerations and forces
  (accelerometer, force, torque, touch, actuator forces of joints, frame accelerations) describe the substep just done,
  and are zero in worlds just reset.
  """

  cfg: BuiltinSensorCfg

  def __init__(self, cfg: BuiltinSensorCfg) -> None:
    super().__init__(cfg)
    self._element = cfg.name if cfg.element is None else cfg.element
    self._columns = torch.empty(0)

  @property
  def dim(self) -> int:
    """Number of values in each world."""
    return self._columns.shape[-1]

  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    cfg = self.cfg
    if cfg.sensor_type is None:
      check_name("sensor element", self._element, names_of(spec, "sensor"), self.label)
      return
    kind = NATIVE_TYPES[cfg.sensor_type].enum
    sensor = add_sensor(spec, self.label, self._element, type=kind, cutoff=cfg.cutoff)
    if cfg.sensor_type == "rangefinder":
      sensor.intprm[0] = sum(1 << _RAY_FIELDS.index(name) for name in cfg.ray_data)
    elif cfg.enclosed:
      sensor.intprm[0] = 1
    for side, ref in (("obj", cfg.obj), ("ref", cfg.ref)):
      if ref is not None:
        setattr(sensor, f"{side}type", getattr(mujoco.mjtObj, f"mjOBJ_{ref.type.upper()}"))
        setattr(sensor, f"{side}name", ref.resolve(spec, entities, self.label))

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    self._columns = sim.data.sensordata[:, sensordata_columns(sim, self._element)]

  def debug_draw(self, draw: DebugDraw) -> None:
    """Draw the sensor's frame, and the direction of a reading that has one."""
    sim, worlds = self.sim, list(draw.worlds)
    model = sim.mj_model
    index = model.sensor(self._element).id
    pose = POSES.get(mujoco.mju_type2Str(model.sensor_objtype[index]))
    if pose is None:
      return
    _ = sim.version
    place, turn = (getattr(sim.data, field)[worlds, int(model.sensor_objid[index])] for field in pose)
    draw.frames(place, quat_from_matrix(turn), 3.0 * self._draw_size)
    kind = next(kind for kind in NATIVE_TYPES.values() if kind.enum.value == model.sensor_type[index])
    is_declared = kind.name in get_args(SensorType)
    has_direction = is_declared and self.dim == 3 and kind.unit != "m"
    if not has_direction or (kind.frame == "reference" and model.sensor_refid[index] >= 0):
      return
    vector = self._columns[worlds]
    self._draw_direction(draw, place, (turn * vector[:, None]).sum(-1) if kind.frame == "own" else vector)

  def _read(self) -> torch.Tensor:
    return self._columns
