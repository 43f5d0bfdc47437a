"""An inertial measurement unit that is a little wrong, in every world in its own way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, sqrt
from typing import TYPE_CHECKING, Any

import mujoco
import torch
from mjlab_core import DebugDraw, quat_apply, quat_apply_inverse, quat_from_rotvec, quat_mul, where_

from mjlab_sensors._elements import names_of
from mjlab_sensors.builtin import ObjRef
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

  The bias of a world is drawn anew whenever it is reset, as that of a device that is switched on, uniformly from plus
  or minus the given magnitude for each axis. That of gyro and accelerometer may also wander from there. Where neither
  is given, it stays what an event has made it (`set_bias`). White noise and delay are the observation manager's.
  """

  site: ObjRef
  """The site that carries the unit and gives its axes."""
  gyro_bias: float = 0.0
  """Largest bias of the angular velocity when switched on [rad/s]."""
  accelerometer_bias: float = 0.0
  """Largest bias of the acceleration when switched on [m/s^2]."""
  orientation_bias: float = 0.0
  """Largest component of the rotation vector by which the orientation that is told is off [rad]."""
  gyro_walk: float = 0.0
  """How fast the bias of the gyro wanders: its standard deviation after one second [rad/s / sqrt(s)]."""
  accelerometer_walk: float = 0.0
  """How fast the bias of the accelerometer wanders, likewise [m/s^2 / sqrt(s)]."""

  def validate(self) -> None:
    if self.site.type != "site":
      raise ValueError(f"{self.label}: an IMU sits at a site, not at {self.site.type} {self.site.name!r}")
    for name in ("gyro_bias", "accelerometer_bias", "orientation_bias", "gyro_walk", "accelerometer_walk"):
      value = getattr(self, name)
      if not (value >= 0.0 and isfinite(value)):
        raise ValueError(f"{self.label}: {name} is a magnitude and must not be negative, but is {value}")

  def _make(self, name: str) -> ImuSensor:
    return ImuSensor(name, self)


@dataclass(kw_only=True)
class ImuData:
  """What an `ImuSensor` tells, bias included. Tensors are the sensor's own: read them, do not write them."""

  angular_velocity: torch.Tensor
  """Angular velocity in the axes of the site, (num_envs, 3) [rad/s]."""
  linear_acceleration: torch.Tensor
  """Acceleration in the axes of the site, that against gravity included: at rest it points up. It is that of the
  substep just done, without bias zero in worlds just reset, (num_envs, 3) [m/s^2]."""
  orientation: torch.Tensor
  """Unit quaternion (w, x, y, z) from the site to the world, (num_envs, 4)."""
  projected_gravity: torch.Tensor
  """Unit vector down, as the orientation tells it, in the axes of the site, (num_envs, 3)."""


class ImuSensor(Sensor[ImuData]):
  """Gyro, accelerometer and orientation of a site, each with a bias."""

  _constants = frozenset({"_gyro", "_accelerometer", "_orientation", "_down"})
  cfg: ImuSensorCfg

  gyro_bias: torch.Tensor
  """Bias of the angular velocity in the axes of the site, (num_envs, 3) [rad/s]."""
  accelerometer_bias: torch.Tensor
  """Bias of the acceleration in the axes of the site, (num_envs, 3) [m/s^2]."""
  orientation_bias: torch.Tensor
  """Rotation vector, in the true axes of the site, that turns them into those that are told, (num_envs, 3) [rad]."""

  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    site, taken = self.cfg.site.resolve(spec, entities, self.label), names_of(spec, "sensor")
    for element, kind in _ELEMENTS.items():
      name = f"{self.name}:{element}"
      if name in taken:
        raise ValueError(f"{self.label}: the scene already has a sensor element {name!r}")
      spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    self._site = sim.mj_model.sensor_objid[sim.mj_model.sensor(f"{self.name}:gyro").id]
    self._gyro, self._accelerometer, self._orientation = (
      sim.data.sensordata[:, sensordata_columns(sim, f"{self.name}:{element}", self.label)] for element in _ELEMENTS
    )
    rows = torch.zeros(3, sim.num_envs, 3, dtype=sim.dtype, device=sim.device)
    self.gyro_bias, self.accelerometer_bias, self.orientation_bias = rows.unbind()
    self._down = torch.tensor((0.0, 0.0, -1.0), dtype=sim.dtype, device=sim.device).expand(sim.num_envs, 3)
    self.reset(torch.ones(sim.num_envs, dtype=torch.bool, device=sim.device))

  def update(self, dt: float) -> None:
    for bias, walk in ((self.gyro_bias, self.cfg.gyro_walk), (self.accelerometer_bias, self.cfg.accelerometer_walk)):
      if walk:
        bias.add_(torch.empty_like(bias).normal_(generator=self.rng), alpha=walk * sqrt(dt))

  def reset(self, mask: torch.Tensor) -> None:
    """Switch the units of the worlds in `mask` on anew, (num_envs,) bool."""
    cfg = self.cfg
    for bias, most, walk in (
      (self.gyro_bias, cfg.gyro_bias, cfg.gyro_walk),
      (self.accelerometer_bias, cfg.accelerometer_bias, cfg.accelerometer_walk),
      (self.orientation_bias, cfg.orientation_bias, 0.0),
    ):
      if most or walk:
        where_(bias, mask, torch.empty_like(bias).uniform_(-most, most, generator=self.rng))

  def set_bias(
    self,
    mask: torch.Tensor,
    *,
    gyro: torch.Tensor | None = None,
    accelerometer: torch.Tensor | None = None,
    orientation: torch.Tensor | None = None,
  ) -> None:
    """Give the worlds in `mask`, (num_envs,) bool, another bias; what is None stays.

    Args:
      mask: which worlds.
      gyro: of the angular velocity, (num_envs, 3) [rad/s].
      accelerometer: of the acceleration, (num_envs, 3) [m/s^2].
      orientation: rotation vector of the axes, (num_envs, 3) [rad].
    """
    for bias, value in (
      (self.gyro_bias, gyro),
      (self.accelerometer_bias, accelerometer),
      (self.orientation_bias, orientation),
    ):
      if value is not None:
        where_(bias, mask, value)

  def debug_draw(self, draw: DebugDraw) -> None:
    """Show where the unit believes to point, and the direction of its acceleration."""
    data, worlds = self.data, list(draw.worlds)
    place, turn = self.sim.data.site_xpos[worlds, self._site], data.orientation[worlds]
    draw.frames(place, turn, 5.0 * self._draw_size)
    force = quat_apply(turn, data.linear_acceleration[worlds])
    direction = force / force.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    draw.arrows(place, place + 5.0 * self._draw_size * direction, (1.0, 1.0, 0.0, 1.0), 0.2 * self._draw_size)

  def _version(self) -> int:
    # Views of one block, which count its writes together.
    return self.gyro_bias._version

  def _read(self) -> ImuData:
    turn = quat_mul(self._orientation, quat_from_rotvec(self.orientation_bias))
    return ImuData(
      angular_velocity=self._gyro + self.gyro_bias,
      linear_acceleration=self._accelerometer + self.accelerometer_bias,
      orientation=turn,
      projected_gravity=quat_apply_inverse(turn, self._down),
    )
