"""Configurations that cannot be are refused by name, when they are made, when they are built, and by the scene."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from mjlab_sensors import (
  BuiltinSensorCfg,
  CameraSensorCfg,
  ContactMatch,
  ContactSensorCfg,
  FrameMatch,
  GridPatternCfg,
  ImuSensorCfg,
  LidarPatternCfg,
  ObjRef,
  PinholeCameraPatternCfg,
  RayCastSensorCfg,
  RingPatternCfg,
  TerrainHeightSensorCfg,
)
from sensor_scenes import simulate, with_robot

ROBOT = """
<mujoco>
  <worldbody>
    <body name="base" pos="0 0 1">
      <freejoint/>
      <geom name="rod" size="0.05"/><geom name="ball_geom" size="0.05"/><geom name="tail_tip" size="0.05"/>
      <site name="imu"/><site name="foot_left"/>
      <camera name="eye" resolution="8 6"/><camera name="blind"/>
      <camera name="flat" projection="orthographic" resolution="8 6"/>
    </body>
  </worldbody>
  <sensor><gyro name="imu_gyro" site="imu"/></sensor>
</mujoco>
"""


def scene() -> mujoco.MjSpec:
  return with_robot(ROBOT, '<geom type="plane" size="0 0 1"/>')


def ref(type_: Any, name: str, entity: str = "robot") -> ObjRef:
  return ObjRef(type=type_, name=name, entity=entity)


def geoms(pattern: str | tuple[str, ...], **kwargs: Any) -> ContactMatch:
  fields: dict[str, Any] = {"mode": "geom", "entity": "robot", **kwargs}
  return ContactMatch(pattern=pattern, **fields)


IMU, BASE, ELBOW = ref("site", "imu"), ref("body", "base"), ref("joint", "elbow")
FEET = FrameMatch(type="site", pattern="foot_.*", entity="robot")
RIGHT: dict[str, Any] = {
  "builtin": BuiltinSensorCfg(sensor_type="clock"),
  "gyro": BuiltinSensorCfg(sensor_type="gyro", obj=IMU),
  "range": BuiltinSensorCfg(sensor_type="rangefinder", obj=IMU),
  "camera": CameraSensorCfg(width=12, height=8),
  "eye": CameraSensorCfg(width=12, height=8, camera="robot/eye"),
  "contact": ContactSensorCfg(primary=geoms(".*")),
  "rays": RayCastSensorCfg(frames=FEET),
  "height": TerrainHeightSensorCfg(frames=FEET),
  "imu": ImuSensorCfg(site=IMU),
}


@pytest.mark.parametrize(
  ("right", "change", "message"),
  [
    ("builtin", {"sensor_type": None}, r"give `element`.* or `sensor_type`"),
    ("builtin", {"sensor_type": "gyroo", "obj": IMU}, r"sensor_type 'gyroo' does not exist. Nearest: gyro"),
    ("builtin", {"obj": IMU}, r"takes none as `obj`"),
    ("builtin", {"sensor_type": "contact", "obj": BASE}, "sensor_type 'contact' does not exist"),
    ("builtin", {"sensor_type": "user"}, "sensor_type 'user' does not exist"),
    ("gyro", {"obj": None}, r"needs a site as `obj`"),
    ("gyro", {"obj": BASE}, r"takes a site as `obj`, not body 'base'"),
    ("gyro", {"ref": IMU}, r"takes none as `ref`, not site 'imu'"),
    ("gyro", {"sensor_type": "framepos", "obj": ELBOW}, r"takes a body or xbody or geom or site or camera as `obj`"),
    ("gyro", {"sensor_type": "distance", "obj": ref("geom", "rod")}, r"distance sensor needs a geom or body as `ref`"),
    ("gyro", {"cutoff": -1.0}, r"cutoff must not be negative"),
    ("gyro", {"element": "robot/imu_gyro", "obj": None, "enclosed": True}, r"leave sensor_type, enclosed out"),
    ("gyro", {"ray_data": ("point",)}, r"ray_data requires sensor_type='rangefinder', got 'gyro'"),
    ("gyro", {"enclosed": True}, r"enclosed requires sensor_type='insidesite', got 'gyro'"),
    ("range", {"ray_data": ("dist", "pnt")}, r"ray_data 'pnt' does not exist. Nea"),
    ("range", {"ray_data": ("point", "dist")}, r"must keep the order"),
    ("camera", {"width": 0}, "width and height must be at least 1, got 0 and 8"),
    ("camera", {"height": -8}, "height must not be negative, got -8"),
    ("camera", {"width": 0, "height": 0}, "width and height must be at least 1, got 0 and 0"),
    ("camera", {"data_types": ("rbg",)}, "data_types 'rbg' does not exist. Nearest: rgb"),
    ("camera", {"data_types": ()}, "data_types must have at least 1 element"),
    ("camera", {"update_period": -1}, "update_period must not be negative, got -1"),
    ("camera", {"geom_groups": (0, 6)}, r"geom_groups must be in \[0, 5\], got \(0, 6\)"),
    ("camera", {"geom_groups": ()}, r"geom_groups must have at least 1 element, got \(\)"),
    ("camera", {"fovy": 180.0}, "fovy must be below 180 degrees, got 180.0"),
    ("camera", {"fovy": 0.0, "orthographic": True}, "fovy must be positive, got 0.0"),
    ("camera", {"orthographic": True}, r"an orthographic camera needs fovy, the height of its image \[m\]"),
    ("camera", {"quat": (0.0, 0.0, 0.0, 0.0)}, "quat must not be zero"),
    ("eye", {"width": 0}, "width and height must be at least 1, got 0 and 8"),
    ("eye", {"orthographic": True}, "camera 'robot/eye' exists already; leave orthographic out"),
    ("eye", {"body": "robot/base"}, "camera 'robot/eye' exists already; leave body out"),
    ("contact", {"fields": ("found", "forse")}, r"fields 'forse' does not exist. Nearest: force"),
    ("contact", {"fields": ()}, r"fields is empty; choose from found"),
    ("contact", {"fields": ("found", "found")}, r"fields must name each element once"),
    ("contact", {"reduce": "maxforces"}, r"reduce 'maxforces' does not exist. Nearest: maxforce"),
    ("contact", {"num_slots": 0}, r"num_slots must be at least 1"),
    ("contact", {"num_slots": 1.5}, r"num_slots must be a whole number, got 1.5"),
    ("contact", {"reduce": "netforce", "num_slots": 2}, r"num_slots must be 1, got 2"),
    ("contact", {"history_length": -1}, r"history_length must not be negative, got -1"),
    ("contact", {"history_length": True}, r"history_length must be a whole number or be 'decimation', got True"),
    ("contact", {"history_length": "decimate"}, r"history_length 'decimate' does not exist. Nearest: decimation"),
    ("contact", {"fields": ("found",), "history_length": 4}, r"add 'force' to fields"),
    *[
      (rays, *row)
      for rays in ("rays", "height")
      for row in (
        ({"alignment": "yaws"}, "alignment 'yaws' does not exist. Nearest: yaw"),
        ({"max_distance": 0.0}, "max_distance must be positive"),
        ({"start_height": -0.1}, "start_height must not be negative"),
        ({"geom_groups": (0, 6)}, r"geom_groups must be in \[0, 5\], got \(0, 6\)"),
        ({"geom_groups": ()}, "geom_groups must have at least 1 element"),
      )
    ],
    ("height", {"reduction": "median"}, "reduction 'median' does not exist"),
    ("imu", {"site": BASE}, "site must be a site, got body 'base'"),
    ("imu", {"gyro_bias": -0.1}, "gyro_bias must not be negative, got -0.1"),
    ("imu", {"accelerometer_walk": math.nan}, "accelerometer_walk must be a number, got nan"),
  ],
)
def test_a_wrong_configuration_is_refused_by_name(right: str, change: dict[str, Any], message: str) -> None:
  message = rf"^{type(RIGHT[right]).__name__} 'probe': .*{message}"
  with pytest.raises(ValueError, match=message):
    dataclasses.replace(RIGHT[right], name="probe", **change)
  edited = dataclasses.replace(RIGHT[right])
  for field, value in change.items():
    setattr(edited, field, value)
  # The scene gives the name.
  with pytest.raises(ValueError, match=message):
    edited.build("probe")
  with pytest.raises(ValueError, match=rf"^{type(edited).__name__}: "):
    edited.validate()


@pytest.mark.parametrize(
  ("right", "change", "message"),
  [
    ("gyro", {"sensor_type": None, "obj": None, "element": "robot/imu_gyr"}, "'robot/imu_gyr' does not exist. Nearest"),
    ("gyro", {"obj": ref("site", "imo")}, r"site 'imo' does not exist. Nearest: imu"),
    ("gyro", {"sensor_type": "framepos", "ref": ref("geom", "rud")}, r"geom 'rud' does not exist. Nearest: rod"),
    ("gyro", {"obj": ref("site", "imu", "robo")}, r"entity 'robo' does not exist. Nearest: robot"),
    (
      "gyro",
      {"name": "robot/imu_gyro"},
      r"already has a sensor element 'robot/imu_gyro'; choose another name, or read",
    ),
    ("camera", {"body": "robot/bose"}, "body 'robot/bose' does not exist. Nearest: robot/base"),
    ("camera", {"name": "robot/eye"}, r"already has this camera; set camera='robot/eye'"),
    ("eye", {"camera": "robot/eya"}, "camera 'robot/eya' does not exist. Nearest: robot/eye"),
    (
      "eye",
      {"camera": "robot/blind", "width": 0, "height": 0},
      "'robot/blind' has no resolution; give width and height",
    ),
    ("contact", {"primary": geoms("bal_geom")}, "primary: pattern 'bal_geom' matches no geom. Nearest: ball_geom"),
    (
      "contact",
      {"primary": geoms("ball_geom", exclude="tial_.*")},
      r"primary: pattern 'tial_.*' matches no excluded geom. Nearest: tail_",
    ),
    ("contact", {"primary": geoms(".*", exclude=".*")}, "no geom is left of pattern .*, exclude"),
    ("contact", {"primary": geoms(())}, "no geom is left of pattern"),
    ("contact", {"primary": geoms(".*", entity="robots")}, "entity 'robots' does not exist. Nearest: robot"),
    (
      "contact",
      {"secondary": ContactMatch(mode="body", pattern="terain")},
      "secondary: pattern 'terain' .* Nearest: ter",
    ),
    (
      "height",
      {"frames": dataclasses.replace(FEET, pattern="fot_left")},
      "frames: pattern 'fot_left' matches no site. Nearest: foot_left",
    ),
    ("imu", {"site": ref("site", "imo")}, "site 'imo' does not exist. Nearest: imu"),
  ],
)
def test_a_name_that_the_scene_does_not_have_is_refused_with_the_nearest(
  right: str, change: dict[str, Any], message: str
) -> None:
  cfg = dataclasses.replace(RIGHT[right], **{"name": "probe", **change})
  with pytest.raises(ValueError, match=rf"{type(cfg).__name__} '{cfg.name}': .*{message}"):
    simulate(scene(), cfg)


def test_a_unit_of_a_model_that_has_its_elements_already_is_refused() -> None:
  spec = mujoco.MjSpec.from_string(ROBOT.replace('name="imu_gyro"', 'name="imu:gyro"'))
  with pytest.raises(ValueError, match="ImuSensorCfg 'imu': the scene already has a sensor element 'imu:gyro'"):
    ImuSensorCfg(name="imu", site=ObjRef(type="site", name="imu")).build().edit_spec(spec, {})


TYPO: Any = "sit"


@pytest.mark.parametrize(
  ("make", "message"),
  [
    (lambda: RingPatternCfg(radius=0.0), "radius must be positive, got 0.0"),
    (lambda: RingPatternCfg(radius=math.nan), "radius must be a number"),
    (lambda: RingPatternCfg(num_samples=0, include_center=False), "must be at least 1 without include_center"),
    (lambda: GridPatternCfg(resolution=0.0), "resolution must be positive"),
    (lambda: GridPatternCfg(resolution=math.nan), "resolution must be a number"),
    (lambda: GridPatternCfg(size=(-1.0, 1.0)), "size must not be negative"),
    (lambda: GridPatternCfg(size=(math.inf, 1.0)), "size must be finite"),
    (lambda: LidarPatternCfg(rows=0), "LidarPatternCfg: .*rows must be at least 1, got 0"),
    (lambda: LidarPatternCfg(vertical_fov=(10, -10)), r"vertical_fov must not fall, got \(10, -10\)"),
    (lambda: LidarPatternCfg(vertical_fov=(-100, 0)), r"vertical_fov must be in \[-90, 90\]"),
    (lambda: LidarPatternCfg(horizontal_fov=(-200, 200)), "horizontal_fov must span at most 360 degrees"),
    (lambda: LidarPatternCfg(horizontal_fov=(20, -20)), "horizontal_fov must not fall"),
    (lambda: PinholeCameraPatternCfg(width=0), "width and height must be at least 1, got 0 and 12"),
    (lambda: PinholeCameraPatternCfg(fovy=180.0), r"fovy must be in \(0, 180\), got 180.0"),
    (lambda: PinholeCameraPatternCfg(focal=(0.0, 1.0)), "focal must be positive"),
    (lambda: PinholeCameraPatternCfg.from_mujoco_camera("eye", width=3), "at least 1, got 3 and 0"),
    (lambda: PinholeCameraPatternCfg(camera="eye", focal=(1.0, 1.0)), "has its own focal and center"),
    (lambda: pinhole([1.0]), r"matrix must be \[\[fx, 0, cx\].*, got \[1.0\]"),
    (lambda: pinhole(np.ones(9)), "without skew"),
    (lambda: looking_through("robot/eya"), "camera 'robot/eya' does not exist. Nearest: robot/eye"),
    (lambda: looking_through("robot/blind"), "camera 'robot/blind' has no resolution; give width and height"),
    (lambda: looking_through("robot/flat"), "camera 'robot/flat' is orthographic"),
    (lambda: FrameMatch(type=TYPO, pattern=".*"), "type 'sit' does not exist. Nearest: site"),
    (lambda: ref(TYPO, "imu"), r"type 'sit' does not exist. Nearest: site"),
    (lambda: geoms(".*", mode="geoms"), r"mode 'geoms' does not exist. Nearest: geom"),
  ],
)
def test_a_wrong_pattern_or_reference_is_refused(make: Callable[[], object], message: str) -> None:
  with pytest.raises(ValueError, match=message):
    make()


def pinhole(matrix: Any) -> PinholeCameraPatternCfg:
  return PinholeCameraPatternCfg.from_intrinsic_matrix(matrix, width=2, height=2)


def looking_through(camera: str) -> object:
  return simulate(
    scene(), dataclasses.replace(RIGHT["rays"], pattern=PinholeCameraPatternCfg.from_mujoco_camera(camera))
  )


def test_names_are_given_once() -> None:
  cfg = ContactSensorCfg(primary=geoms(".*"))
  with pytest.raises(ValueError, match="needs one name"):
    cfg.build()
  assert cfg.build("feet").name == "feet"
  with pytest.raises(ValueError, match="needs one name"):
    dataclasses.replace(cfg, name="feet").build("hands")


def test_reading_before_there_is_a_simulation_says_so() -> None:
  with pytest.raises(RuntimeError, match="'feet': not initialized"):
    _ = RIGHT["contact"].build("feet").data
