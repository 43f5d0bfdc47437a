"""A gear stays inside the actuator: targets are those of the joint, for every actuator model and for the MJCF's own.

One closed form for all: with every target in the joint's own units, the effort at the joint is that of the same
actuator without a gear, and at rest the joint is where its position target says.
"""

from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from actuator_models import build, chain
from mjlab_actuators import (
  ActuatorCfg,
  ActuatorSet,
  NativeDcMotorActuatorCfg,
  NativeGeneralActuatorCfg,
  NativeMotorActuatorCfg,
  XmlActuatorCfg,
)

KP, KD = 50.0, 4.0
Q, V = 0.2, -0.6
TARGETS = {"position_target": 0.5, "velocity_target": 0.3, "effort_target": 1.2}
ALL = tuple(TARGETS)


def pd(*inputs: str) -> float:
  """Effort at the joint of a PD actuator with these targets, the others zero."""
  target = {name: TARGETS[name] if name in inputs else 0.0 for name in ALL}
  position = KP * (target["position_target"] - Q) if "position_target" in inputs else 0.0
  damping = KD * (target["velocity_target"] - V)
  return position + damping + target["effort_target"]


def dc(gear: float, *inputs: Any) -> ActuatorCfg:
  gains: dict[str, Any] = {"stiffness": KP if "position_target" in inputs else 0.0, "damping": KD}
  return NativeDcMotorActuatorCfg(
    target_names_expr=("j",), torque_constant=0.5, resistance=0.1, inputs=inputs, gear=gear, **gains
  )


def general(gear: float, field: Any, bias: tuple[float, ...]) -> ActuatorCfg:
  # A gear multiplies the force once more, and lengths and rates with it.
  gain = {"position_target": KP, "velocity_target": KD, "effort_target": 1.0}[field]
  squared = 1.0 if field == "effort_target" else gear**2
  numbers: dict[str, Any] = {"gain_prm": (gain / squared,), "bias_type": "affine" if any(bias) else "none"}
  return NativeGeneralActuatorCfg(
    target_names_expr=("j",), command_field=field, bias_prm=tuple(b / gear**2 for b in bias), gear=gear, **numbers
  )


XML = XmlActuatorCfg(target_names_expr=("j",))
DC = 'motorconst=".5" resistance=".1"'
CASES: dict[str, Any] = {
  "motor": lambda g: (NativeMotorActuatorCfg(target_names_expr=("j",), gear=g), "", TARGETS["effort_target"]),
  "general, position": lambda g: (general(g, "position_target", (0.0, -KP, -KD)), "", pd("position_target")),
  "general, velocity": lambda g: (general(g, "velocity_target", (0.0, 0.0, -KD)), "", pd("velocity_target")),
  "general, effort": lambda g: (general(g, "effort_target", ()), "", TARGETS["effort_target"]),
  **{
    f"dc motor, {', '.join(inputs)}": lambda g, i=inputs: (dc(g, *i), "", pd(*i))
    for inputs in [ALL[:1], ALL[1:2], ALL[:2], ALL, (ALL[0], ALL[2])]
  },
  **{
    f"MJCF {kind}": lambda g, own=own, expected=expected: (
      XML,
      f'<{own.format(kp=KP / g**2, kd=KD / g**2)} joint="j" gear="{g}"/>',
      expected,
    )
    for kind, own, expected in [
      ("position", 'position kp="{kp}" kv="{kd}"', pd("position_target")),
      ("velocity", 'velocity kv="{kd}"', pd("velocity_target")),
      ("motor", "motor", TARGETS["effort_target"]),
      ("pid", 'pid kp="{kp}" kv="{kd}" input="pos vel ff"', pd(*ALL)),
      ("dc motor", f'dcmotor {DC} input="pos vel" controller="{{kp}} 0 {{kd}}"', pd(*ALL[:2])),
    ]
  },
}


def ctrl_of(actuators: ActuatorSet, targets: dict[str, float]) -> np.ndarray:
  columns = [torch.full((1, 1), targets[name], dtype=torch.float64) for name in ALL]
  return actuators.compute(*columns, *columns[:2])[0].numpy()


@pytest.mark.parametrize("gear", [1.0, 2.0, -3.0])
@pytest.mark.parametrize("case", CASES)
def test_the_effort_at_the_joint_is_the_closed_form_at_any_gear(case: str, gear: float) -> None:
  cfg, own, expected = CASES[case](gear)
  model, actuators = build(chain("j", actuators=own), cfg)
  data = mujoco.MjData(model)
  data.qpos[:], data.qvel[:] = Q, V
  data.ctrl[:] = ctrl_of(actuators, TARGETS)
  mujoco.mj_forward(model, data)
  assert data.qfrc_actuator[0] == pytest.approx(expected)


@pytest.mark.parametrize(
  "case", [case for case in CASES if "position" in case or case in ("MJCF pid", "MJCF dc motor")]
)
def test_a_geared_servo_rests_where_its_target_is(case: str) -> None:
  cfg, own, _ = CASES[case](2.0)
  model, actuators = build(chain("j", actuators=own), cfg)
  data = mujoco.MjData(model)
  data.ctrl[:] = ctrl_of(actuators, {"position_target": 0.5, "velocity_target": 0.0, "effort_target": 0.0})
  for _ in range(1500):
    mujoco.mj_step(model, data)
  assert data.qpos[0] == pytest.approx(0.5, abs=1e-4)


def test_the_constants_of_a_geared_dc_motor_with_a_controller_are_those_of_the_motor() -> None:
  """The voltage model and the controller agree at full voltage, friction and cogging included."""
  numbers: dict[str, Any] = {
    "target_names_expr": ("j",),
    "cogging": (0.1, 6.0, 0.2),
    "lugre": (100.0, 1.0, 0.1, 0.2, 0.3),
    "effort_limit": 4.0,
  }
  both: list[dict[str, Any]] = [{"torque_constant": 0.5, "resistance": 0.1}, {"nominal": (24.0, 10.0, 30.0)}]
  for constants in both:
    for gear in (2.0, -3.0):
      sign = np.sign(gear)
      motors = [
        NativeDcMotorActuatorCfg(voltage_limit=1.5, gear=gear, **constants, **numbers),
        NativeDcMotorActuatorCfg(
          inputs=("position_target",), stiffness=1e6, voltage_limit=1.5, gear=gear, **constants, **numbers
        ),
      ]
      forces = []
      for cfg, command in zip(motors, ({"effort_target": sign * 1.5}, {"position_target": 9.0}), strict=True):
        model, actuators = build(chain("j"), cfg)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = Q, V
        # At the joint, the bristles of the friction bend by what they do at the motor, over the gear.
        data.act[:] = 0.001 * (sign if cfg.inputs == "voltage" else 1.0 / abs(gear))
        data.ctrl[:] = ctrl_of(actuators, dict.fromkeys(ALL, 0.0) | command)
        mujoco.mj_forward(model, data)
        forces.append(data.qfrc_actuator[0])
      assert forces[0] == pytest.approx(forces[1]), (constants, gear)


def test_volts_and_the_activation_of_a_muscle_pass_a_gear_unchanged() -> None:
  for own in (
    f'<dcmotor joint="j" {DC} gear="2"/>',
    '<muscle joint="j" lengthrange="0 1" force="10" gear="2"/>',
  ):
    _, actuators = build(chain("j", actuators=own), XML)
    assert ctrl_of(actuators, TARGETS).tolist() == [TARGETS["effort_target"]]
