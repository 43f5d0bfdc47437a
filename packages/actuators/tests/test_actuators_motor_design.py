"""Gains put the poles where they are wanted; inertia reflects with the square of the ratio."""

import math

import numpy as np
import pytest
from mjlab_actuators import gains_from_frequency, reflected_inertia, reflected_inertia_of_stages, rotary_to_linear


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


def test_a_lever_keeps_power_and_energy() -> None:
  linear = rotary_to_linear(inertia=0.01, velocity_limit=30.0, effort_limit=2.0, radius=0.05)
  assert linear.velocity_limit * linear.effort_limit == pytest.approx(30.0 * 2.0)
  assert linear.mass * linear.velocity_limit**2 == pytest.approx(0.01 * 30.0**2)


def test_impossible_numbers_are_refused() -> None:
  with pytest.raises(ValueError, match=r"inertia is -1.0"):
    gains_from_frequency(-1.0, 10.0, 1.0)
  with pytest.raises(ValueError, match="gear_ratio is nan"):
    reflected_inertia(1.0, math.nan)
  with pytest.raises(ValueError, match="radius is 0"):
    rotary_to_linear(1.0, 1.0, 1.0, 0.0)
  with pytest.raises(ValueError, match="3 inertias need 3 or 2 gear ratios, not 1"):
    reflected_inertia_of_stages([1.0, 1.0, 1.0], [2.0])
