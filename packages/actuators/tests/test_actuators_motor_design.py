"""Gains put the poles where they are wanted; inertia reflects with the square of the ratio."""

import math

import mujoco
import numpy as np
import pytest
from actuator_models import build
from mjlab_actuators import (
  NativePositionActuatorCfg,
  gains_from_frequency,
  reflected_inertia,
  reflected_inertia_of_stages,
)


@pytest.mark.parametrize("damping_ratio", [0.3, 1.0, 2.0])
def test_gains_place_the_poles(damping_ratio: float) -> None:
  inertia, frequency = 0.02, 10.0
  kp, kd = gains_from_frequency(inertia, frequency, damping_ratio)
  poles = np.roots([inertia, kd, kp])
  omega = 2 * math.pi * frequency
  np.testing.assert_allclose(np.prod(poles).real, omega**2)
  np.testing.assert_allclose(-np.sum(poles).real / (2 * omega), damping_ratio)


def test_energy_of_a_geared_rotor_is_that_of_its_reflected_inertia() -> None:
  rotor, ratio, joint_speed = 1e-4, 9.0, 3.0
  assert reflected_inertia(rotor, ratio) * joint_speed**2 == pytest.approx(rotor * (ratio * joint_speed) ** 2)


def test_stages_add_up_and_one_stage_is_the_plain_formula() -> None:
  assert reflected_inertia_of_stages([2.0], [3.0]) == reflected_inertia(2.0, 3.0)
  assert reflected_inertia_of_stages([1.0, 2.0, 5.0], [3.0, 4.0]) == 1.0 * 144 + 2.0 * 16 + 5.0


@pytest.mark.parametrize("damping_ratio", [0.2, 1.0])
def test_a_servo_with_these_gains_follows_the_second_order_response(damping_ratio: float) -> None:
  inertia, frequency = 0.02, 2.0
  kp, kd = gains_from_frequency(inertia, frequency, damping_ratio)
  xml = f"""
  <mujoco><option timestep="1e-4" gravity="0 0 0" integrator="RK4"/><worldbody><body>
    <joint name="j" armature="{inertia}"/><inertial pos="0 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/>
  </body></worldbody></mujoco>"""
  model, _ = build(xml, NativePositionActuatorCfg(target_names_expr=("j",), stiffness=kp, damping=kd))
  data = mujoco.MjData(model)
  data.qpos[0], data.ctrl[0] = 1.0, 0.0
  omega, zeta = 2 * math.pi * frequency, damping_ratio
  for _ in range(3):
    for _ in range(1000):
      mujoco.mj_step(model, data)
    t = data.time
    if zeta == 1.0:
      expected = (1 + omega * t) * math.exp(-omega * t)
    else:
      damped = omega * math.sqrt(1 - zeta**2)
      ripple = math.cos(damped * t) + zeta * omega / damped * math.sin(damped * t)
      expected = math.exp(-zeta * omega * t) * ripple
    assert data.qpos[0] == pytest.approx(expected, abs=1e-5)


def test_impossible_numbers_are_refused() -> None:
  with pytest.raises(ValueError, match=r"inertia must not be negative"):
    gains_from_frequency(-1.0, 10.0, 1.0)
  with pytest.raises(ValueError, match="gear_ratio must be a number"):
    reflected_inertia(1.0, math.nan)
  with pytest.raises(ValueError, match="3 inertias need 3 or 2 gear ratios, not 1"):
    reflected_inertia_of_stages([1.0, 1.0, 1.0], [2.0])
