"""Native, contact, inertial, ray-cast, camera and terrain-height sensors over batched MuJoCo worlds."""

from mjlab_sensors.camera import CameraData, CameraSensor, CameraSensorCfg
from mjlab_sensors.contact import ContactData, ContactMatch, ContactSensor, ContactSensorCfg
from mjlab_sensors.frames import FrameMatch
from mjlab_sensors.native.builtin import BuiltinSensor, BuiltinSensorCfg, ObjRef, SensorType
from mjlab_sensors.native.imu import ImuData, ImuSensor, ImuSensorCfg
from mjlab_sensors.native.native_types import NATIVE_TYPES, NativeType
from mjlab_sensors.patterns import GridPatternCfg, LidarPatternCfg, RayPatternCfg, RingPatternCfg
from mjlab_sensors.pinhole import PinholeCameraPatternCfg
from mjlab_sensors.ray_cast import RayCastData, RayCastSensor, RayCastSensorCfg
from mjlab_sensors.sensor import Sensor, SensorCfg
from mjlab_sensors.terrain_height import TerrainHeightData, TerrainHeightSensor, TerrainHeightSensorCfg

__all__ = [
  "NATIVE_TYPES",
  "BuiltinSensor",
  "BuiltinSensorCfg",
  "CameraData",
  "CameraSensor",
  "CameraSensorCfg",
  "ContactData",
  "ContactMatch",
  "ContactSensor",
  "ContactSensorCfg",
  "FrameMatch",
  "GridPatternCfg",
  "ImuData",
  "ImuSensor",
  "ImuSensorCfg",
  "LidarPatternCfg",
  "NativeType",
  "ObjRef",
  "PinholeCameraPatternCfg",
  "RayCastData",
  "RayCastSensor",
  "RayCastSensorCfg",
  "RayPatternCfg",
  "RingPatternCfg",
  "Sensor",
  "SensorCfg",
  "SensorType",
  "TerrainHeightData",
  "TerrainHeightSensor",
  "TerrainHeightSensorCfg",
]
