"""Gains and limits are scaled where they live, with nothing but tensors that look like a simulation's model."""

from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import mujoco
import numpy as np
import pytest
import torch
from mjlab_actuators import (
  ActuatorCfg,
  ActuatorParameter,
  ActuatorSet,
  IdealPd,
  IdealPdActuatorCfg,
  LearnedMlp,
  LearnedMlpActuatorCfg,
  NativeGeneralActuatorCfg,
  NativePdActuatorCfg,
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
  ParameterName,
  XmlActuatorCfg,
)

ARM = """
<mujoco>
  <worldbody>
    <body><geom size="0.1"/><joint name="a" actuatorfrcrange="-4 4"/>
      <body><geom size="0.1"/><joint name="b"/><body><geom size="0.1"/><joint name="c"/></body></body></body>
  </worldbody>
  %s
</mujoco>
"""
WORLDS = 3
MASK = torch.tensor([True, False, True])


class Worlds:
  """Fields of a model for several worlds, in torch."""

  def __init__(self, model: mujoco.MjModel) -> None:
    self.num_envs, self.device, self.mj_model, self.model = WORLDS, torch.device("cpu"), model, SimpleNamespace()

  def expand_model_fields(self, names: Iterable[str]) -> None:
    for name in set(names) - vars(self.model).keys():
      setattr(self.model, name, self.default_field(name).repeat(WORLDS, 1, 1))

  def default_field(self, name: str) -> torch.Tensor:
    return torch.as_tensor(getattr(self.mj_model, name))[None].clone()

  def recompute_constants(self, mask: torch.Tensor | None = None) -> None:
    raise AssertionError("no constant follows from gains, limits or delays")


def build(*cfgs: ActuatorCfg, own: str = "") -> tuple[ActuatorSet, Worlds]:
  spec = mujoco.MjSpec.from_string(ARM % own)
  actuators = ActuatorSet(cfgs, "entity 'arm'")
  actuators.edit_spec(spec)
  model = spec.compile()
  return actuators.build(model, num_envs=WORLDS, device="cpu", dtype=torch.float64), Worlds(model)


def in_mujoco(sim: Worlds, world: int) -> mujoco.MjModel:
  """The compiled model with the fields of one world."""
  for name, values in vars(sim.model).items():
    getattr(sim.mj_model, name)[:] = values[world].numpy()
  return sim.mj_model


def test_a_scaled_servo_is_the_servo_of_a_config_with_those_numbers() -> None:
  def servo(kp: float, kd: float, limit: float) -> ActuatorCfg:
    return NativePositionActuatorCfg(target_names_expr=("b", "c"), stiffness=kp, damping=kd, effort_limit=limit)

  actuators, sim = build(servo(2.0, 0.3, 5.0))
  factors: dict[ParameterName, float] = {"stiffness": 1.5, "damping": 0.5, "effort_limit": 2.0}
  for name, factor in factors.items():
    parameter = ActuatorParameter(actuators, sim, name)
    for _ in range(100):
      parameter.scale(torch.full((WORLDS, 2), factor, dtype=torch.float64), MASK)
  for world, numbers in ((0, (3.0, 0.15, 10.0)), (1, (2.0, 0.3, 5.0))):
    wanted = build(servo(*numbers))[1].mj_model
    for field in ("gainprm", "biasprm", "forcerange"):
      got = getattr(in_mujoco(sim, world), f"actuator_{field}")
      np.testing.assert_allclose(got, getattr(wanted, f"actuator_{field}"), rtol=1e-15)


def test_scaled_gains_of_pd_in_mujoco_also_weigh_its_targets() -> None:
  actuators, sim = build(NativePdActuatorCfg(target_names_expr=("b",), stiffness=2.0, damping=0.5, effort_limit=9.0))
  factors: dict[ParameterName, float] = {"stiffness": 3.0, "damping": 4.0, "effort_limit": 0.5}
  for name, factor in factors.items():
    parameter = ActuatorParameter(actuators, sim, name)
    for _ in range(2):
      parameter.scale(torch.full((WORLDS, 1), factor).double(), MASK)
    assert parameter.values()[0].item() == parameter.default.item() * factor
  position, velocity, effort = (torch.full((WORLDS, 3), value).double() for value in (0.3, -0.4, 0.7))
  ctrl = actuators.compute(position, velocity, effort, position, velocity)
  for world, (kp, kd, limit) in enumerate([(6.0, 2.0, 4.5), (2.0, 0.5, 9.0), (6.0, 2.0, 4.5)]):
    model = in_mujoco(sim, world)
    data = mujoco.MjData(model)
    data.qpos[1], data.qvel[1], data.ctrl[0] = 0.1, 0.2, ctrl[world, 0]
    mujoco.mj_forward(model, data)
    assert data.actuator_force[0] == pytest.approx(kp * (0.3 - 0.1) + kd * (-0.4 - 0.2) + 0.7)
    assert model.actuator_forcerange[0, 1] == limit


def test_each_target_gets_its_factor_in_torch_and_in_mujoco() -> None:
  actuators, sim = build(
    NativeVelocityActuatorCfg(target_names_expr=("c",), damping=3.0),
    IdealPdActuatorCfg(target_names_expr=("a", "b"), stiffness=1.0, damping={"a": 2.0, "b": 4.0}),
  )
  parameter = ActuatorParameter(actuators, sim, "damping")
  assert parameter.default.tolist() == [[2.0, 4.0, 3.0]]
  assert {
    (field, text.split("'")[1]) for (field, column), text in parameter.claims.items() if isinstance(column, int)
  } == {("actuator_gainprm", "c"), ("actuator_biasprm", "c")}
  factor = torch.tensor([[1.0, 2.0, 3.0]], dtype=torch.float64) + torch.arange(WORLDS)[:, None]
  parameter.scale(factor, MASK)
  (actuator,) = (actuator for actuator in actuators.groups if isinstance(actuator, IdealPd))
  assert actuator.damping.tolist() == [[2.0, 8.0], [2.0, 4.0], [6.0, 16.0]]
  assert sim.model.actuator_gainprm[:, 0, 0].tolist() == [9.0, 3.0, 15.0]
  assert sim.model.actuator_biasprm[:, 0, 2].tolist() == [-9.0, -3.0, -15.0]


def test_the_limit_of_the_joint_follows_unless_several_actuators_share_it() -> None:
  servo: dict[str, Any] = {"target_names_expr": ("a",), "stiffness": 2.0, "damping": 0.0, "effort_limit": 3.0}
  actuators, sim = build(NativePositionActuatorCfg(**servo))
  ActuatorParameter(actuators, sim, "effort_limit").scale(torch.full((WORLDS, 1), 2.0).double(), MASK)
  assert sim.model.jnt_actfrcrange[:, 0].tolist() == [[-8.0, 8.0], [-4.0, 4.0], [-8.0, 8.0]]
  own = '<actuator><motor name="push" joint="a"/></actuator>'
  actuators, sim = build(NativePositionActuatorCfg(**servo), own=own)
  message = "entity 'arm': effort_limit of joint 'a': 2 actuators share its actuatorfrcrange"
  with pytest.raises(ValueError, match=message):
    ActuatorParameter(actuators, sim, "effort_limit")


def test_a_one_sided_force_range_is_scaled_and_a_missing_one_is_refused() -> None:
  general: dict[str, Any] = {"target_names_expr": ("b",), "command_field": "effort_target"}
  actuators, sim = build(NativeGeneralActuatorCfg(force_range=(-6.0, 0.0), **general))
  parameter = ActuatorParameter(actuators, sim, "effort_limit")
  assert parameter.default.tolist() == [[6.0]]
  parameter.scale(torch.full((WORLDS, 1), 0.5).double(), MASK)
  assert sim.model.actuator_forcerange[0, 0].tolist() == [-3.0, 0.0]
  actuators, sim = build(NativeGeneralActuatorCfg(**general))
  for name in get_args(ParameterName):
    with pytest.raises(ValueError, match=f"{name} of joint 'b': its actuator has none"):
      ActuatorParameter(actuators, sim, name)


def test_the_gains_of_a_wrapped_pid_are_found() -> None:
  own = '<actuator><pid name="all" joint="c" kp="2" kv="5" ki="9" input="pos vel ff"/></actuator>'
  actuators, sim = build(XmlActuatorCfg(target_names_expr=("c",)), own=own)
  gains: dict[ParameterName, tuple[float, int]] = {"stiffness": (2.0, 1), "damping": (5.0, 2)}
  for name, (value, column) in gains.items():
    parameter = ActuatorParameter(actuators, sim, name)
    assert parameter.default.item() == value
    parameter.scale(torch.full((WORLDS, 1), 3.0).double(), MASK)
    assert sim.model.actuator_biasprm[:, 0, column].tolist() == [-3.0 * value, -value, -3.0 * value]


def test_a_learned_motor_has_an_effort_limit_but_no_gains_to_be_scaled(tmp_path: Path) -> None:
  torch.save({"0.weight": torch.ones(1, 2)}, tmp_path / "n.pt")
  learned = LearnedMlpActuatorCfg(
    target_names_expr=("a",), network_file=tmp_path / "n.pt", history_length=1, effort_limit=3.0
  )
  actuators, sim = build(learned)
  gains: list[ParameterName] = ["stiffness", "damping"]
  for name in gains:
    with pytest.raises(ValueError, match=f"{name} of joint 'a': its actuator has none"):
      ActuatorParameter(actuators, sim, name)
  ActuatorParameter(actuators, sim, "effort_limit").scale(torch.full((WORLDS, 1), 2.0).double(), MASK)
  (actuator,) = actuators.groups
  assert isinstance(actuator, LearnedMlp)
  assert actuator.effort_limit.tolist() == [[6.0], [3.0], [6.0]]
