"""Motors whose effort falls with speed: DC motor and measured envelope, against their curves point by point."""

import math
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from actuator_models import build, chain
from mjlab_actuators import (
  UNITREE_ENVELOPES,
  ActuatorCfg,
  ActuatorCmd,
  ActuatorSet,
  DcMotorActuatorCfg,
  EnvelopedPdActuatorCfg,
  TorqueSpeedEnvelope,
)

ARM = chain("a", "b")
STALL, NO_LOAD, LIMIT = 10.0, 20.0, 6.0


ENVELOPE = TorqueSpeedEnvelope(full_effort_speed=10.0, no_load_speed=20.0, motoring_effort=4.0, braking_effort=6.0)


def dc(**changes: Any) -> DcMotorActuatorCfg:
  numbers: dict[str, Any] = {
    "stiffness": 0.0,
    "damping": 0.0,
    "saturation_effort": STALL,
    "velocity_limit": NO_LOAD,
    "effort_limit": LIMIT,
  }
  return DcMotorActuatorCfg(target_names_expr=(".*",), **(numbers | changes))


def enveloped(envelope: Any = ENVELOPE) -> EnvelopedPdActuatorCfg:
  return EnvelopedPdActuatorCfg(target_names_expr=(".*",), stiffness=0.0, damping=0.0, envelope=envelope)


def given(cfg: ActuatorCfg, wanted: float, velocity: float) -> float:
  """The effort that a motor of one joint gives when `wanted` is asked of it at `velocity`."""
  (actuator,) = build(chain("x"), cfg)[1].groups
  zero = torch.zeros(1, 1, dtype=torch.float64)
  return actuator.compute(ActuatorCmd(zero, zero, zero + wanted, zero, zero + velocity)).item()


# The current limit cuts the line off below 8 rad/s; against the motion it is all that limits.
LINE = {-100.0: 6.0, -20.0: 6.0, 0.0: 6.0, 8.0: 6.0, 12.0: 4.0, 19.0: 0.5, 20.0: 0.0, 21.0: 0.0, 99.0: 0.0}


@pytest.mark.parametrize(("velocity", "upper"), LINE.items())
def test_a_dc_motor_follows_its_line_up_to_the_no_load_speed(velocity: float, upper: float) -> None:
  assert given(dc(), 1e3, velocity) == pytest.approx(upper, abs=1e-12)
  assert given(dc(), -1e3, -velocity) == pytest.approx(-upper, abs=1e-12)
  # An effort within the bounds passes unchanged: zero stays zero at any speed.
  assert given(dc(), 0.0, velocity) == 0.0


@pytest.mark.parametrize("velocity", [-60.0, -31.0, -25.0, -20.0, -7.0, 0.0, 3.0, 19.0, 20.0, 24.0, 32.0, 50.0])
@pytest.mark.parametrize("wanted", [-1e3, -3.0, 0.0, 0.5, 1e3])
def test_a_braking_dc_motor_follows_its_line_beyond_the_no_load_speed(velocity: float, wanted: float) -> None:
  bounded = min(max(velocity, -NO_LOAD * (1 + LIMIT / STALL)), NO_LOAD * (1 + LIMIT / STALL))
  upper = min(STALL * (1 - bounded / NO_LOAD), LIMIT)
  lower = max(STALL * (-1 - bounded / NO_LOAD), -LIMIT)
  assert given(dc(braking=True), wanted, velocity) == pytest.approx(min(max(wanted, lower), upper), abs=1e-12)


def test_without_a_current_limit_the_line_goes_on_against_the_motion() -> None:
  assert given(dc(effort_limit=None), 1e3, -NO_LOAD) == pytest.approx(2 * STALL)
  assert given(dc(effort_limit=None), 1e3, 0.0) == pytest.approx(STALL)
  assert given(dc(effort_limit=None, braking=True), 1e3, 2 * NO_LOAD) == pytest.approx(-STALL)


def test_mujoco_applies_pd_within_the_line() -> None:
  model, actuators = build(ARM, dc(stiffness={"a": 3.0, "b": 30.0}, damping=0.4), num_envs=64)
  generator = torch.Generator().manual_seed(0)
  target, rate, effort, position, velocity = (
    torch.randn(64, 2, generator=generator, dtype=torch.float64) * scale for scale in (2.0, 3.0, 2.0, 1.0, 12.0)
  )
  ctrl = actuators.compute(target, rate, effort, position, velocity)
  wanted = (torch.tensor([3.0, 30.0]) * (target - position) + 0.4 * (rate - velocity) + effort).numpy()
  v = velocity.numpy()
  expected = np.clip(
    wanted, -np.clip(STALL * (1 + v / NO_LOAD), 0.0, LIMIT), np.clip(STALL * (1 - v / NO_LOAD), 0.0, LIMIT)
  )
  assert 0.1 < np.mean(expected != wanted) < 0.9
  data = mujoco.MjData(model)
  for world in range(64):
    data.qpos[:], data.qvel[:], data.ctrl[:] = position[world], velocity[world], ctrl[world]
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_actuator, expected[world], rtol=1e-12, atol=1e-12)


def test_a_joint_driven_by_a_dc_motor_settles_at_its_no_load_speed() -> None:
  spec = mujoco.MjSpec.from_string(ARM)
  spec.option.gravity = [0.0, 0.0, 0.0]
  motor = dc(effort_limit=None)
  motor.target_names_expr = ("a",)
  actuators = ActuatorSet([motor])
  actuators.edit_spec(spec)
  spec.joint("a").armature = 1.0
  spec.delete(spec.body("world").first_body().first_body())
  model = spec.compile()
  actuators.build(model, num_envs=1, device="cpu", dtype=torch.float64)
  data, zero = mujoco.MjData(model), torch.zeros(1, 1, dtype=torch.float64)
  inertia = 1.0 + model.body_inertia[1, 0]
  for _ in range(500):
    velocity = torch.from_numpy(data.qvel[None].copy())
    data.ctrl[:] = actuators.compute(zero, zero, zero + 1e3, zero, velocity)[0].numpy()
    mujoco.mj_step(model, data)
  # J v' = S (1 - v / W): the speed nears W with the time constant J W / S.
  expected = NO_LOAD * (1 - math.exp(-data.time * STALL / (NO_LOAD * inertia)))
  assert data.qvel[0] == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(
  ("velocity", "with_motion", "against"),
  [(1e-6, 4.0, 6.0), (10.0, 4.0, 6.0), (15.0, 2.0, 6.0), (19.0, 0.4, 6.0), (20.0, 0.0, 6.0), (30.0, 0.0, 6.0)],
)
def test_an_envelope_limits_driving_and_braking(velocity: float, with_motion: float, against: float) -> None:
  for sense in (1.0, -1.0):
    assert given(enveloped(), sense * 1e3, sense * velocity) == pytest.approx(sense * with_motion)
    assert given(enveloped(), -sense * 1e3, sense * velocity) == pytest.approx(-sense * against)
    assert given(enveloped(), -sense * 1.5, sense * velocity) == -sense * 1.5


def test_an_envelope_holds_with_its_braking_effort_at_rest() -> None:
  assert given(enveloped(), 1e3, 0.0) == 6.0


def test_each_joint_has_its_motor() -> None:
  _, actuators = build(
    ARM, enveloped({"a": UNITREE_ENVELOPES["N7520-14.3"], "b": UNITREE_ENVELOPES["W4010-25"]}), num_envs=1
  )
  zero = torch.zeros(1, 2, dtype=torch.float64)
  assert actuators.compute(zero, zero, zero + 1e3, zero, zero + 1.0)[0].tolist() == [71.0, 4.8]
  assert actuators.compute(zero, zero, zero - 1e3, zero, zero + 1.0)[0].tolist() == [-83.3, -8.6]


@pytest.mark.parametrize("name", UNITREE_ENVELOPES)
def test_published_envelopes_build(name: str) -> None:
  build(ARM, enveloped(UNITREE_ENVELOPES[name]))


def test_motors_of_one_model_are_one_computation_and_braking_ones_another() -> None:
  def one(joint: str, **changes: Any) -> ActuatorCfg:
    cfg = dc(**changes)
    cfg.target_names_expr = (joint,)
    return cfg

  _, actuators = build(ARM, one("b", saturation_effort=3.0), one("a"))
  (actuator,) = actuators.groups
  assert actuator.target_names == ("a", "b")
  assert actuator.expand("saturation_effort").tolist() == [[STALL, 3.0]]
  _, actuators = build(ARM, one("b", braking=True), one("a"))
  assert [actuator.target_names for actuator in actuators.groups] == [("b",), ("a",)]


def test_limits_raised_per_world_act_in_that_world_only() -> None:
  model, actuators = build(ARM, dc(), num_envs=2)
  (actuator,) = actuators.groups
  zero = torch.zeros(2, 2, dtype=torch.float64)
  for name in ("effort_limit", "saturation_effort"):
    actuator.expand(name)[1] *= 10.0
  ctrl = actuators.compute(zero, zero, zero + 1e3, zero, zero)
  assert ctrl.tolist() == [[LIMIT, LIMIT], [10 * LIMIT, 10 * LIMIT]]
  assert not model.actuator_forcelimited.any()
  assert not model.actuator_ctrllimited.any()


@pytest.mark.parametrize(
  ("cfg", "message"),
  [
    (
      dc(saturation_effort={"a": 1.0, "b": 0.0}),
      "DcMotorActuatorCfg: saturation_effort must be positive, got .*'b': 0.0",
    ),
    (dc(velocity_limit=-3.0), "DcMotorActuatorCfg: velocity_limit must be positive, got -3.0"),
    (dc(velocity_limit=math.inf), "velocity_limit must be finite, got inf"),
    (dc(effort_limit=0.0), "effort_limit must be positive, got 0.0"),
    (dc(stiffness=-1.0), "stiffness must not be negative, got -1.0"),
    (dc(stiffness=float("nan")), "stiffness must be a number, got nan"),
    (dc(stiffness={"a": "30", "b": 1.0}), "stiffness must be a number, got .*'a': '30'"),
    (dc(saturation_effort={"[ab]c": 1.0}), "DcMotorActuatorCfg.saturation_effort: pattern .* matches no joint"),
    (
      enveloped(TorqueSpeedEnvelope(20.0, 10.0, 4.0, 6.0)),
      "joint 'a' must have full_effort_speed 20.0 below no_load_speed 10.0",
    ),
    (
      enveloped(TorqueSpeedEnvelope(10.0, 20.0, 6.0, 4.0)),
      "joint 'a' must have .* motoring_effort 6.0 above 0 and at most braking_effort 4.0",
    ),
    (enveloped(TorqueSpeedEnvelope(10.0, 20.0, 0.0, 4.0)), "motoring_effort 0.0 above 0"),
    (enveloped({"a": UNITREE_ENVELOPES["Go2HV"]}), "EnvelopedPdActuatorCfg.envelope: no pattern .* joint .*b"),
  ],
)
def test_impossible_motors_are_refused_by_name_at_build(cfg: ActuatorCfg, message: str) -> None:
  with pytest.raises(ValueError, match=message):
    build(ARM, cfg)
