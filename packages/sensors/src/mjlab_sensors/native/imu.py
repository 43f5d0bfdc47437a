"""Inertial measurement unit with separate biases in each world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING, Any

import mujoco
import torch
from mjlab_core import (
  DebugDraw,
  NonNegative,
  quat_apply,
  quat_apply_inverse,
  quat_from_rotvec,
  quat_mul,
  where_,
)
from mjlab_core.torch_internals import version_of

from mjlab_sensors.native._elements import add_sensor
from mjlab_sensors.native.builtin import ObjRef
from mjlab_sensors.sensor import Sensor, SensorCfg, sensordata_columns

if TYPE_CHECKING:
  from mjlab_sim import Simulation

_ELEMENTS = {
  "gyro": mujoco.mjtSensor.mjSENS_GYRO,
  "accelerometer": mujoco.mjtSensor.mjSENS_ACCELEROMETER,
  "orientation": mujoco.mjtSensor.mjSENS_FRAMEQUAT,
}


@dataclass(kw_only=True)
class ImuSensorCfg(SensorCfg):
  """Gyro, accelerometer and orientation of a site, each with a bias.

  A reset draws the bias of a world, as when a device is switched on: each axis uniformly from plus or minus the given
  magnitude. The biases of gyro and accelerometer may also walk from there. Without both, a bias keeps the value that an
  event has set (`set_bias`). White noise and delay belong to the observation manager.
  """

  site: ObjRef
  """Site of the unit, which gives its axes."""
  gyro_bias: NonNegative = 0.0
  """Largest bias of the angular velocity at a reset [rad/s]."""
  accelerometer_bias: NonNegative = 0.0
  """Largest bias of the acceleration at a reset [m/s^2]."""
  orientation_bias: NonNegative = 0.0
  """Largest component of the rotation vector from the true to the measured orientation [rad]."""
  gyro_walk: NonNegative = 0.0
  """Random walk of the gyro's bias: standard deviation after one second [rad/s / sqrt(s)]."""
  accelerometer_walk: NonNegative = 0.0
  """Random walk of the accelerometer's bias: standard deviation after one second [m/s^2 / sqrt(s)]."""

  def problems(self) -> Iterator[str]:
    if self.site.type != "site":
      yield f"site must be a site, got {self.site.type} {self.site.name!r}"


@dataclass(kw_only=True)
class ImuData:
  """Reading of an `ImuSensor`, bias included. The tensors are the sensor's own memory."""

  angular_velocity: torch.Tensor
  """Angular velocity in the axes of the site, (num_envs, 3) [rad/s]."""
  linear_acceleration: torch.Tensor
  """Acceleration relative to free fall, in the axes of the site: at rest it points up. It is that of the substep just
  done; without bias it is zero in worlds just reset, (num_envs, 3) [m/s^2]."""
  orientation: torch.Tensor
  """Unit quaternion (w, x, y, z) from the site to the world, (num_envs, 4)."""
  projected_gravity: torch.Tensor
  """Unit vector that points down according to `orientation`, in the axes of the site, (num_envs, 3)."""


class ImuSensor(Sensor[ImuData], cfg=ImuSensorCfg):
  """Gyro, accelerometer and orientation of a site, each with a bias."""

  cfg: ImuSensorCfg

  gyro_bias: torch.Tensor
  """Bias of the angular velocity in the axes of the site, (num_envs, 3) [rad/s]."""
  accelerometer_bias: torch.Tensor
  """Bias of the acceleration in the axes of the site, (num_envs, 3) [m/s^2]."""
  orientation_bias: torch.Tensor
  """Rotation vector, in the true axes of the site, that turns them into the measured axes, (num_envs, 3) [rad]."""

  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    site = self.cfg.site.resolve(spec, entities, self.label)
    for element, kind in _ELEMENTS.items():
      add_sensor(spec, self.label, f"{self.name}:{element}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    self._site = sim.mj_model.sensor_objid[sim.mj_model.sensor(f"{self.name}:gyro").id]
    self._gyro, self._accelerometer, self._orientation = (
      sim.data.sensordata[:, sensordata_columns(sim, f"{self.name}:{element}")] for element in _ELEMENTS
    )
    self.gyro_bias, self.accelerometer_bias, self.orientation_bias = self._biases = [
      self.state((3,), dtype=sim.dtype) for _ in _ELEMENTS
    ]
    self._down = torch.tensor((0.0, 0.0, -1.0), dtype=sim.dtype, device=sim.device).expand(sim.num_envs, 3)
    self.reset(torch.ones(sim.num_envs, dtype=torch.bool, device=sim.device))

  def update(self, dt: float) -> None:
    for bias, walk in zip(self._biases, self._walks, strict=True):
      if walk:
        bias.add_(torch.empty_like(bias).normal_(generator=self.rng), alpha=walk * sqrt(dt))

  def reset(self, mask: torch.Tensor) -> None:
    """Draw the biases of the worlds in `mask`, (num_envs,) bool."""
    magnitudes = self.cfg.gyro_bias, self.cfg.accelerometer_bias, self.cfg.orientation_bias
    for bias, most, walk in zip(self._biases, magnitudes, self._walks, strict=True):
      if most or walk:
        where_(bias, mask, torch.empty_like(bias).uniform_(-most, most, generator=self.rng))

  @property
  def _walks(self) -> tuple[float, float, float]:
    return self.cfg.gyro_walk, self.cfg.accelerometer_walk, 0.0

  def set_bias(
    self,
    mask: torch.Tensor,
    *,
    gyro: torch.Tensor | None = None,
    accelerometer: torch.Tensor | None = None,
    orientation: torch.Tensor | None = None,
  ) -> None:
    """Set the biases of the worlds in `mask`; a bias that is None stays.

    Args:
      mask: worlds to set, (num_envs,) bool.
      gyro: bias of the angular velocity, (num_envs, 3) [rad/s].
      accelerometer: bias of the acceleration, (num_envs, 3) [m/s^2].
      orientation: bias of the orientation, a rotation vector, (num_envs, 3) [rad].
    """
    for bias, value in zip(self._biases, (gyro, accelerometer, orientation), strict=True):
      if value is not None:
        where_(bias, mask, value)

  def debug_draw(self, draw: DebugDraw) -> None:
    """Draw the measured orientation, and the direction of the measured acceleration."""
    data, worlds = self.data, list(draw.worlds)
    place, turn = self.sim.data.site_xpos[worlds, self._site], data.orientation[worlds]
    draw.frames(place, turn, 5.0 * self._draw_size)
    self._draw_direction(draw, place, quat_apply(turn, data.linear_acceleration[worlds]))

  def _version(self) -> int:
    return sum(map(version_of, self._biases))

  def _read(self) -> ImuData:
    turn = quat_mul(self._orientation, quat_from_rotvec(self.orientation_bias))
    return ImuData(
      angular_velocity=self._gyro + self.gyro_bias,
      linear_acceleration=self._accelerometer + self.accelerometer_bias,
      orientation=turn,
      projected_gravity=quat_apply_inverse(turn, self._down),
    )
