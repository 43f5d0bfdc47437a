"""Muscle, general actuator and DC motor from a config: MuJoCo C applies what their configs promise."""

from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from actuator_models import build
from mjlab_actuators import (
  ActuatorCfg,
  ActuatorSet,
  IdealPdActuatorCfg,
  NativeDcMotorActuatorCfg,
  NativeGeneralActuatorCfg,
  NativeMuscleActuatorCfg,
  NativePdActuatorCfg,
)

ARM = """
<mujoco>
  <default>
    <general gear="7" ctrlrange="-0.1 0.1" forcerange="-0.2 0.2" dynprm="9" gainprm="9" biasprm="9 9 9"/>
  </default>
  <worldbody>
    <body><geom size="0.1"/><joint name="a" axis="0 1 0" range="-60 90"/>
      <body pos="0 0 1"><geom size="0.1"/><joint name="b" axis="0 1 0"/></body></body>
  </worldbody>
</mujoco>
"""
TARGET, RATE, EFFORT, POSITION, VELOCITY = 0.9, -0.4, 1.3, 0.3, 0.7


def make(*cfgs: ActuatorCfg) -> tuple[mujoco.MjModel, ActuatorSet]:
  return build(ARM, *cfgs, owner="entity 'arm'")


def applied(cfg: ActuatorCfg, **changes: float) -> float:
  """The effort that MuJoCo applies at joint a, with these targets and measurements at all joints."""
  values = {"target": TARGET, "rate": RATE, "effort": EFFORT, "position": POSITION, "velocity": VELOCITY} | changes
  model, actuators = make(cfg)
  ctrl = actuators.compute(*(torch.full((1, 2), value, dtype=torch.float64) for value in values.values()))
  data = mujoco.MjData(model)
  data.qpos[:], data.qvel[:] = values["position"], values["velocity"]
  assert actuators.ctrl_ids == tuple(range(model.nu))
  data.ctrl[:] = ctrl[0].numpy()
  mujoco.mj_forward(model, data)
  return float(data.qfrc_actuator[0])


def dc(**changes: Any) -> NativeDcMotorActuatorCfg:
  numbers: dict[str, Any] = {"torque_constant": 0.5, "resistance": 2.0} | changes
  return NativeDcMotorActuatorCfg(target_names_expr=("a",), **numbers)


def general(**changes: Any) -> NativeGeneralActuatorCfg:
  fields: dict[str, Any] = {"target_names_expr": ("a",), "command_field": "position_target"}
  return NativeGeneralActuatorCfg(**(fields | changes))


def muscle(**changes: Any) -> NativeMuscleActuatorCfg:
  fields: dict[str, Any] = {"target_names_expr": ("a",), "force": 50.0}
  return NativeMuscleActuatorCfg(**(fields | changes))


def test_a_voltage_drives_the_motor_against_its_back_emf() -> None:
  assert applied(dc()) == pytest.approx(0.5 * (EFFORT - 0.5 * VELOCITY) / 2.0)
  assert applied(dc(voltage_limit=1.0)) == pytest.approx(0.5 * (1.0 - 0.5 * VELOCITY) / 2.0)
  assert applied(dc(gear=3.0)) == pytest.approx(3.0 * 0.5 * (EFFORT - 0.5 * 3.0 * VELOCITY) / 2.0)
  assert applied(dc(effort_limit=0.1)) == pytest.approx(0.1)


def test_a_data_sheet_gives_the_stall_torque_and_the_no_load_speed() -> None:
  cfg = dc(torque_constant=None, resistance=None, nominal=(24.0, 10.0, 30.0))
  assert applied(cfg, effort=24.0, velocity=0.0) == pytest.approx(10.0)
  assert applied(cfg, effort=24.0, velocity=30.0) == pytest.approx(0.0, abs=1e-12)
  assert applied(cfg, effort=24.0, velocity=15.0) == pytest.approx(5.0)


@pytest.mark.parametrize(
  ("inputs", "expected"),
  [
    (("position_target",), 3.0 * (TARGET - POSITION) - 0.2 * VELOCITY),
    (("effort_target", "position_target"), 3.0 * (TARGET - POSITION) - 0.2 * VELOCITY + EFFORT),
    (("velocity_target", "position_target"), 3.0 * (TARGET - POSITION) + 0.2 * (RATE - VELOCITY)),
    (
      ("position_target", "velocity_target", "effort_target"),
      3.0 * (TARGET - POSITION) + 0.2 * (RATE - VELOCITY) + EFFORT,
    ),
  ],
)
def test_the_controller_of_the_motor_follows_its_targets(inputs: Any, expected: float) -> None:
  assert applied(dc(inputs=inputs, stiffness=3.0, damping=0.2)) == pytest.approx(expected)
  at_most = 0.5 * (1.5 - 0.5 * VELOCITY) / 2.0
  assert at_most < expected
  assert applied(dc(inputs=inputs, stiffness=3.0, damping=0.2, voltage_limit=1.5)) == pytest.approx(at_most)


def test_a_dc_motor_from_a_config_is_the_dc_motor_of_the_mjcf() -> None:
  model, _ = make(
    dc(
      inputs=("position_target", "velocity_target"),
      stiffness=3.0,
      integral_gain=1.5,
      damping=0.2,
      slew_rate=7.0,
      integral_limit=0.4,
      voltage_limit=24.0,
      inductance=0.01,
      cogging=(0.1, 6.0, 0.2),
      thermal=(5.0, 2.0, 0.0, 0.004, 20.0, 25.0),
      lugre=(100.0, 1.0, 0.1, 0.2, 0.3),
    )
  )
  written = mujoco.MjModel.from_xml_string("""
  <mujoco><worldbody><body><geom size="0.1"/><joint name="a"/></body></worldbody>
    <actuator><dcmotor name="a" joint="a" motorconst="0.5" resistance="2" inductance="0.01" input="pos vel"
      controller="3 1.5 0.2 7 0.4 24" cogging="0.1 6 0.2" thermal="5 2 0 0.004 20 25" lugre="100 1 0.1 0.2 0.3"/>
    </actuator></mujoco>""")
  assert model.na == written.na == 5
  for name in ("gainprm", "biasprm", "dynprm", "gaintype", "biastype", "dyntype", "ctrlspec", "ctrlnum"):
    np.testing.assert_array_equal(getattr(model, f"actuator_{name}"), getattr(written, f"actuator_{name}"))


def test_cogging_adds_its_wave() -> None:
  cogging = applied(dc(cogging=(0.1, 6.0, 0.2))) - applied(dc())
  assert cogging == pytest.approx(0.1 * np.sin(6.0 * POSITION + 0.2))


def test_each_input_of_many_motors_gets_its_target() -> None:
  fields = ("position_target", "velocity_target", "effort_target")
  cfgs = [dc(inputs=fields, stiffness=1.0, damping=1.0), dc(inputs=("velocity_target",), damping=1.0)]
  cfgs[0].target_names_expr, cfgs[1].target_names_expr = ("b",), ("a",)
  _, actuators = make(*cfgs)
  rows = [torch.tensor([[10.0 * k, 10.0 * k + 1]], dtype=torch.float64) for k in (1, 2, 3)]
  assert actuators.compute(*rows, *rows[:2])[0].tolist() == [11.0, 21.0, 31.0, 20.0]


def pd(**changes: Any) -> NativePdActuatorCfg:
  gains: dict[str, Any] = {"stiffness": 3.0, "damping": 0.2} | changes
  return NativePdActuatorCfg(target_names_expr=("a",), **gains)


def test_pd_in_mujoco_limits_the_sum_of_its_three_targets() -> None:
  free = 3.0 * (TARGET - POSITION) + 0.2 * (RATE - VELOCITY) + EFFORT
  assert applied(pd()) == pytest.approx(free)
  # Each part alone is beyond the limit, the sum is not; then the other way round.
  assert applied(pd(effort_limit=1.5), target=3.0, effort=-8.0) == pytest.approx(3.0 * 2.7 + 0.2 * (RATE - 0.7) - 8.0)
  assert free > 1.5
  assert applied(pd(effort_limit=1.5)) == pytest.approx(1.5)


def test_pd_in_mujoco_is_the_pd_of_torch_at_a_small_timestep_and_is_stable_at_a_large_one() -> None:
  """The implicit integrator knows the derivative of the force, so a stiff damper stays stable."""
  ends: dict[tuple[str, float], np.ndarray] = {}
  gains: dict[str, Any] = {"target_names_expr": (".*",), "stiffness": 40.0, "damping": 30.0, "effort_limit": 50.0}
  for kind, cfg in (("native", NativePdActuatorCfg(**gains)), ("torch", IdealPdActuatorCfg(**gains))):
    for timestep in (1e-4, 1e-2):
      model, actuators = make(cfg)
      model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
      model.opt.timestep = timestep
      data = mujoco.MjData(model)
      target = torch.tensor([[0.4, -0.3]], dtype=torch.float64)
      for _ in range(round(0.5 / timestep)):
        state = (torch.tensor(array[None]) for array in (data.qpos, data.qvel))
        data.ctrl[:] = actuators.compute(target, 0.2 * target, 3.0 * target, *state)[0].numpy()
        mujoco.mj_step(model, data)
      ends[kind, timestep] = data.qpos.copy()
  np.testing.assert_allclose(ends["native", 1e-4], ends["torch", 1e-4], atol=1e-4)
  np.testing.assert_allclose(ends["native", 1e-2], ends["native", 1e-4], atol=0.02)
  assert not np.abs(ends["torch", 1e-2] - ends["torch", 1e-4]).max() < 0.1


def test_a_general_actuator_follows_its_closed_form() -> None:
  affine = general(
    gain_type="affine", gain_prm=(1.0, 2.0, 3.0), bias_type="affine", bias_prm=(0.5, -1.5, 0.25), gear=2.0
  )
  length, rate = 2.0 * POSITION, 2.0 * VELOCITY
  force = (1.0 + 2.0 * length + 3.0 * rate) * 2.0 * TARGET + 0.5 - 1.5 * length + 0.25 * rate
  assert applied(affine) == pytest.approx(2.0 * force)
  assert applied(general(gain_prm=(4.0,), command_field="velocity_target")) == pytest.approx(4.0 * RATE)
  assert applied(general(ctrl_range=(-0.1, 0.2))) == pytest.approx(0.2)
  assert applied(general(force_range=(-0.1, 0.3))) == pytest.approx(0.3)


def test_a_general_actuator_filters_its_input() -> None:
  model, _ = make(general(dyn_type="filterexact", dyn_prm=(0.1,), act_range=(-1.0, 0.5)))
  data = mujoco.MjData(model)
  data.ctrl[:] = 1.0
  seen = []
  for _ in range(200):
    mujoco.mj_step(model, data)
    seen.append(data.act[0])
  times = model.opt.timestep * np.arange(1, 201)
  np.testing.assert_allclose(seen, np.minimum(1.0 - np.exp(-times / 0.1), 0.5), rtol=1e-9)


def test_a_muscle_pulls_with_its_peak_force_at_its_optimal_length() -> None:
  low, high = -np.pi / 3, np.pi / 2
  optimal = (high - low) / (1.05 - 0.75)
  model, actuators = make(muscle(), muscle(target_names_expr=("b",), length_range=(-1.0, 2.0), gear=-1.0))
  np.testing.assert_allclose(model.actuator_lengthrange, [[low, high], [-1.0, 2.0]])
  command = torch.tensor([[0.3, 1.7]], dtype=torch.float64)
  other = torch.full_like(command, float("nan"))
  data = mujoco.MjData(model)
  data.ctrl[:] = actuators.compute(other, other, command, other, other)[0].numpy()
  data.qpos[:] = low + 0.25 * optimal, -(-1.0 + 0.25 * 3.0 / 0.3)
  data.act[:] = 0.4
  mujoco.mj_forward(model, data)
  np.testing.assert_allclose(data.qfrc_actuator, [-50.0 * 0.4, 50.0 * 0.4], rtol=1e-9)
  # Activation slows down as it nears one and deactivation as it nears zero; u is clamped to 1.
  np.testing.assert_allclose(
    data.act_dot, [(0.3 - 0.4) / (0.04 / (0.5 + 1.5 * 0.4)), (1.0 - 0.4) / (0.01 * (0.5 + 1.5 * 0.4))]
  )


def test_a_muscle_from_a_config_is_the_muscle_of_the_mjcf() -> None:
  model, _ = make(muscle(lmin=0.4, lmax=1.7, vmax=2.0, fpmax=1.1, fvmax=1.4, range=(0.8, 1.1), smoothing=0.02))
  written = mujoco.MjModel.from_xml_string("""
  <mujoco><compiler><lengthrange uselimit="true"/></compiler>
    <worldbody><body><geom size="0.1"/><joint name="a" axis="0 1 0" range="-60 90"/></body></worldbody>
    <actuator><muscle name="a" joint="a" force="50" range="0.8 1.1" lmin="0.4" lmax="1.7" vmax="2" fpmax="1.1"
      fvmax="1.4" tausmooth="0.02"/></actuator></mujoco>""")
  for name in ("gainprm", "biasprm", "dynprm", "gaintype", "biastype", "dyntype", "gear"):
    np.testing.assert_array_equal(getattr(model, f"actuator_{name}"), getattr(written, f"actuator_{name}"))
  np.testing.assert_allclose(model.actuator_lengthrange, written.actuator_lengthrange)


@pytest.mark.parametrize(
  ("cfg", "message"),
  [
    (dc(nominal=(24.0, 1.0, 1.0)), "give torque_constant and resistance, or nominal"),
    (dc(resistance=None), "give torque_constant and resistance, or nominal"),
    (dc(resistance=-1.0), "resistance must be positive, got -1.0"),
    (dc(torque_constant=None, resistance=None, nominal=(24.0, 0.0, 1.0)), "nominal must be positive, got"),
    (dc(voltage_limit=0.0), "voltage_limit must be positive"),
    (dc(damping=1.0), "inputs 'voltage' has none"),
    (dc(inputs=("position_target",)), "position_target is an input, but its gain is 0"),
    (dc(inputs=("velocity_target",)), "velocity_target is an input, but its gain is 0"),
    (dc(inputs=("posiiton_target",)), "inputs 'posiiton_target' does not exist. Nearest: position_target"),
    (dc(inputs=()), "name at least one target"),
    (dc(inductance=-1.0), "inductance must not be negative"),
    (dc(slew_rate=-1.0), "slew_rate must not be negative"),
    (dc(cogging=(0.1, float("nan"), 0.0)), "cogging must be a number"),
    (dc(inputs=("velocity_target",), damping=1.0, integral_gain=1.0), "inputs has no position_target to integrate"),
    (dc(integral_gain=1.0), "inputs 'voltage' has none"),
    (dc(gear=0.0), "gear must not be zero"),
    (dc(effort_limit=-2.0), "effort_limit must be positive, got -2.0"),
    (general(gain_type="afine"), "gain_type 'afine' does not exist. Nearest: affine"),
    (general(command_field="position"), "command_field 'position' does not exist. Nearest: position_target"),
    (general(force_range=(1.0, -1.0)), r"force_range must rise, got \(1.0, -1.0\)"),
    (general(ctrl_range=(0.0, 0.0)), "ctrl_range must rise"),
    (general(dyn_type="filter"), "a filter has a positive time constant"),
    (general(gain_prm=(1.0, 2.0, 3.0, 4.0)), "gain_prm must have at most 3 elements"),
    (general(gain_prm=(2.0,), bias_type="affine", bias_prm=(0.0, -2.0, 0.5)), "takes a positive b2 for a damping"),
    (general(gear=float("nan")), "gear must be a number"),
    (muscle(target_names_expr=("b",)), "NativeMuscleActuatorCfg: joint 'b' is not limited, so length_range must be"),
    (muscle(length_range=(1.0, -1.0)), r"length_range must rise, got \(1.0, -1.0\)"),
    (muscle(range=(1.05, 0.75)), r"range must rise, got \(1.05, 0.75\)"),
    (muscle(lmin=2.0), "lmin 2.0 must be below lmax 1.6"),
    (muscle(force=0.0), "force must be positive, got 0.0"),
    (muscle(time_constants=(0.01, 0.0)), "time_constants must be positive"),
    (muscle(vmax=0.0), "vmax must be positive"),
    (muscle(gear=0.0), "gear must not be zero"),
    (pd(stiffness=0.0), "stiffness must be positive, got 0.0"),
    (pd(velocity_limit=-1.0), "velocity_limit must be positive, got -1.0"),
    (muscle(target_names_expr=("elbow",)), "entity 'arm': pattern 'elbow' matches no joint"),
  ],
)
def test_impossible_numbers_are_refused_by_name_at_build(cfg: ActuatorCfg, message: str) -> None:
  with pytest.raises(ValueError, match=message):
    make(cfg)
