"""An inertial measurement unit: MuJoCo's readings and a bias of each world's own."""

from typing import Any

import mujoco
import pytest
import torch
from mjlab_core import quat_error_magnitude, quat_from_rotvec, quat_mul
from mjlab_sensors import ImuSensor, ImuSensorCfg, ObjRef
from mjlab_sim import Simulation
from sensor_scenes import simulate

ROBOT = """
<mujoco>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <body name="box" pos="0 0 0.1">
      <freejoint/>
      <geom type="box" size="0.1 0.1 0.1" mass="1"/>
      <site name="imu" pos="0 0 0.05" euler="0 0 90"/>
    </body>
  </worldbody>
  <sensor>
    <gyro name="gyro" site="imu"/><accelerometer name="accelerometer" site="imu"/>
    <framequat name="quat" objtype="site" objname="imu"/>
  </sensor>
</mujoco>
"""
SITE = ObjRef(type="site", name="imu")
ALL = torch.ones(64, dtype=torch.bool)


def build(num_envs: int = 64, **biases: Any) -> tuple[Simulation, ImuSensor]:
  cfg = ImuSensorCfg(name="imu", site=SITE, **biases)
  sim, (sensor,) = simulate(mujoco.MjSpec.from_string(ROBOT), cfg, num_envs=num_envs)
  return sim, sensor


def true_readings(sim: Simulation) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
  columns = {"gyro": slice(0, 3), "accelerometer": slice(3, 6), "quat": slice(6, 10)}
  _ = sim.version
  gyro, accelerometer, quat = (sim.data.sensordata[:, column].clone() for column in columns.values())
  return gyro, accelerometer, quat


def test_without_bias_it_reads_what_mujoco_does_and_gravity_when_it_rests() -> None:
  sim, sensor = build(num_envs=2)
  sim.data.qvel[:, 3:] = torch.tensor([0.5, 0.2, -0.3], dtype=sim.dtype)
  for _ in range(2000):
    sim.step()
    data = sensor.data
    read = (data.angular_velocity, data.linear_acceleration, data.orientation)
    for value, true in zip(read, true_readings(sim), strict=True):
      torch.testing.assert_close(value, true)
  up = torch.tensor([[0.0, 0.0, 9.81]] * 2, dtype=sim.dtype)
  torch.testing.assert_close(sensor.data.linear_acceleration, up, rtol=1e-3, atol=1e-3)
  torch.testing.assert_close(sensor.data.projected_gravity, -up / 9.81, rtol=1e-3, atol=1e-3)


def test_a_bias_is_added_in_the_axes_of_the_site() -> None:
  sim, sensor = build(gyro_bias=0.2, accelerometer_bias=0.5, orientation_bias=0.1)
  sim.data.qvel[:, 3:] = 0.3
  sim.step()
  gyro, accelerometer, quat = true_readings(sim)
  data = sensor.data
  torch.testing.assert_close(data.angular_velocity, gyro + sensor.gyro_bias)
  torch.testing.assert_close(data.linear_acceleration, accelerometer + sensor.accelerometer_bias)
  torch.testing.assert_close(data.orientation, quat_mul(quat, quat_from_rotvec(sensor.orientation_bias)))
  angle = quat_error_magnitude(data.orientation, quat)
  torch.testing.assert_close(angle, sensor.orientation_bias.norm(dim=1))
  for bias, most in ((sensor.gyro_bias, 0.2), (sensor.accelerometer_bias, 0.5), (sensor.orientation_bias, 0.1)):
    assert bias.abs().max() <= most
    # Uniform: every world and axis has its own, with the deviation of that distribution.
    assert bias.unique().numel() == bias.numel()
    assert bias.std().item() == pytest.approx(most / 3**0.5, rel=0.15)


def test_a_reset_draws_biases_of_masked_worlds_alone() -> None:
  _, sensor = build(gyro_bias=0.2)
  before = sensor.gyro_bias.clone()
  mask = torch.arange(64) % 2 == 0
  sensor.reset(mask)
  assert torch.equal(sensor.gyro_bias[~mask], before[~mask])
  assert (sensor.gyro_bias[mask] != before[mask]).all()


def test_a_bias_that_is_set_is_read_at_once_and_survives_resets_without_draws() -> None:
  _, sensor = build(gyro_bias=0.2)
  mask = torch.arange(64) < 10
  _ = sensor.data
  sensor.set_bias(mask, accelerometer=torch.full((64, 3), 0.7), orientation=torch.full((64, 3), 0.01))
  assert sensor.data.linear_acceleration[:, 0].tolist() == [pytest.approx(0.7)] * 10 + [0.0] * 54
  sensor.reset(ALL)
  torch.testing.assert_close(sensor.accelerometer_bias[mask], torch.full((10, 3), 0.7, dtype=torch.float64))
  # Writing to the bias itself is seen just as well.
  sensor.gyro_bias.fill_(1.0)
  assert (sensor.data.angular_velocity == 1.0).all()


def test_a_bias_walks_with_the_root_of_time_and_restarts_at_zero() -> None:
  _, sensor = build(num_envs=512, gyro_walk=0.1, accelerometer_walk=0.4)
  for _ in range(400):
    sensor.update(0.005)
  for bias, walk in ((sensor.gyro_bias, 0.1), (sensor.accelerometer_bias, 0.4)):
    assert bias.std().item() == pytest.approx(walk * 2**0.5, rel=0.1)
    assert abs(bias.mean().item()) < 0.05 * walk * 2**0.5 * 3
  sensor.reset(torch.arange(512) < 100)
  assert not sensor.gyro_bias[:100].any()
  assert sensor.gyro_bias[100:].all()
