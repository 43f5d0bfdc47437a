"""Every target arrives at its own ctrl, whatever the order of configs, elements and joints."""

import itertools
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from actuator_models import build, chain
from mjlab_actuators import (
  ActuatorCfg,
  ActuatorSet,
  IdealPdActuatorCfg,
  NativeMotorActuatorCfg,
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
  XmlActuatorCfg,
)

JOINTS = ("a", "b", "c", "d")
CHAIN = chain(*JOINTS)


def command(field: int, joint: str) -> float:
  """A number that says whose it is: 10.0 is the position target of a, 33.0 the effort target of d."""
  return 10.0 * (field + 1) + JOINTS.index(joint)


def identifiable(order: tuple[str, ...], num_envs: int = 2) -> list[torch.Tensor]:
  zeros = torch.zeros(num_envs, len(order), dtype=torch.float64)
  rows = [torch.tensor([command(f, j) for j in order], dtype=torch.float64).repeat(num_envs, 1) for f in range(3)]
  return [*rows, zeros, zeros]


def cfg_for(kind: str, *joints: str, lag: int = 0) -> ActuatorCfg:
  fields: dict[str, Any] = {"target_names_expr": joints, "delay_min_lag": lag, "delay_max_lag": lag}
  return {
    "position": lambda: NativePositionActuatorCfg(stiffness=1.0, damping=0.0, **fields),
    "velocity": lambda: NativeVelocityActuatorCfg(damping=1.0, **fields),
    "motor": lambda: NativeMotorActuatorCfg(**fields),
    "pd": lambda: IdealPdActuatorCfg(stiffness=1.0, damping=0.0, **fields),
  }[kind]()


def expected(kind: str, joint: str) -> float:
  fields = {"position": (0,), "velocity": (1,), "motor": (2,), "pd": (0, 2)}[kind]
  return sum(command(field, joint) for field in fields)


@pytest.mark.parametrize("kinds", list(itertools.permutations(["position", "velocity", "motor", "pd"])))
@pytest.mark.parametrize("lag", [0, 2])
def test_each_ctrl_gets_the_target_of_its_joint(kinds: tuple[str, ...], lag: int) -> None:
  assignment = dict(zip(("b", "d", "a", "c"), kinds, strict=True))
  cfgs = [cfg_for(kind, joint, lag=lag) for joint, kind in assignment.items()]
  ctrl = torch.full((2, 4), -1.0, dtype=torch.float64)
  model, actuators = build(CHAIN, *cfgs, num_envs=2, ctrl=ctrl)
  actuators.compute(*identifiable(JOINTS))
  for joint, kind in assignment.items():
    index = model.actuator(joint).id
    assert model.actuator_trnid[index, 0] == model.joint(joint).id
    assert ctrl[:, index].tolist() == [expected(kind, joint)] * 2, (joint, kind)


@pytest.mark.parametrize("kind", ["position", "velocity", "motor", "pd"])
def test_configs_of_one_model_are_one_computation_in_every_order(kind: str) -> None:
  for parts in itertools.permutations([("a", "d"), ("b",), ("c",)]):
    model, actuators = build(CHAIN, *(cfg_for(kind, *joints) for joints in parts), num_envs=2)
    assert len(actuators.groups) == 1
    ctrl = actuators.compute(*identifiable(JOINTS))
    assert ctrl[0].tolist() == [expected(kind, model.actuator(i).name) for i in actuators.ctrl_ids]


def test_two_motor_types_may_be_one_config_or_two() -> None:
  whole = [IdealPdActuatorCfg(target_names_expr=(".*",), stiffness={"[ac]": 1.0, "[bd]": 2.0}, damping=0.0)]
  split = [
    IdealPdActuatorCfg(target_names_expr=("b", "d"), stiffness=2.0, damping=0.0),
    IdealPdActuatorCfg(target_names_expr=("a", "c"), stiffness=1.0, damping=0.0),
  ]
  results = []
  for cfgs in (whole, split):
    model, actuators = build(CHAIN, *cfgs, num_envs=2)
    ctrl = actuators.compute(*identifiable(JOINTS))
    names = [model.actuator(i).name for i in actuators.ctrl_ids]
    results.append(dict(zip(names, ctrl[0].tolist(), strict=True)))
  assert results[0] == results[1]


def test_different_delays_are_different_computations() -> None:
  cfgs = [cfg_for("pd", "a"), cfg_for("pd", "b", lag=1), cfg_for("pd", "c", "d", lag=1)]
  _, actuators = build(CHAIN, *cfgs, num_envs=2)
  assert [actuator.target_names for actuator in actuators.groups] == [("a",), ("b", "c", "d")]


WRAPPED = """
    <motor name="push" joint="d" gear="5" ctrlrange="-1 1"/>
    <velocity name="spin" joint="b" kv="2"/>
    <position name="hold" joint="a" kp="3" dampratio="1" ctrlrange="-30 30"/>
    <general name="also_hold" joint="b" gainprm="4" biastype="affine" biasprm="0 -4 -1"/>
"""


def wrap(own: str, *cfgs: ActuatorCfg, **options: Any) -> tuple[mujoco.MjModel, ActuatorSet]:
  """A chain with the actuators above and these."""
  return build(chain(*JOINTS, actuators=WRAPPED + own), *cfgs, num_envs=2, **options)


def test_wrapped_actuators_take_the_target_of_their_kind() -> None:
  own = '<intvelocity name="creep" joint="c" kp="2" actrange="-1 1"/>'
  plain = mujoco.MjModel.from_xml_string(chain(*JOINTS, actuators=WRAPPED + own))
  model, actuators = wrap(own, XmlActuatorCfg(target_names_expr=(".*",)))
  ctrl = actuators.compute(*identifiable(JOINTS))
  wanted = {
    "push": command(2, "d") / 5.0,
    "spin": command(1, "b"),
    "hold": command(0, "a"),
    "also_hold": command(0, "b"),
    "creep": command(1, "c"),
  }
  assert ctrl[0].tolist() == [wanted[model.actuator(i).name] for i in range(model.nu)]
  for field in ("gainprm", "biasprm", "gear", "ctrlrange", "ctrllimited", "forcerange", "dynprm"):
    np.testing.assert_array_equal(getattr(model, f"actuator_{field}"), getattr(plain, f"actuator_{field}"))


def test_a_pid_with_several_inputs_takes_one_target_each() -> None:
  own = '<pid name="all" joint="c" kp="2" kv="1" input="pos vel ff"/>'
  model, actuators = wrap(own, XmlActuatorCfg(target_names_expr=("c",)))
  assert model.actuator("all").id == 4
  assert actuators.ctrl_ids == (4, 5, 6)
  assert actuators.compute(*identifiable(JOINTS))[0].tolist() == [command(field, "c") for field in range(3)]


@pytest.mark.parametrize(
  ("inputs", "fields"), [("", [2]), ('input="pos" controller="3"', [0]), ('input="pos vel" controller="3 0 1"', [0, 1])]
)
def test_a_dc_motor_of_the_mjcf_takes_its_voltage_or_the_targets_of_its_controller(
  inputs: str, fields: list[int]
) -> None:
  own = f'<dcmotor name="m" joint="c" motorconst="0.5" resistance="2" {inputs}/>'
  _, actuators = wrap(own, XmlActuatorCfg(target_names_expr=("c",)))
  assert actuators.compute(*identifiable(JOINTS))[0].tolist() == [command(field, "c") for field in fields]


def test_a_prefix_and_other_entities_in_the_model_change_nothing() -> None:
  spec = mujoco.MjSpec.from_string(chain(*JOINTS, actuators=WRAPPED))
  actuators = ActuatorSet([XmlActuatorCfg(target_names_expr=("a", "b")), cfg_for("pd", "c")])
  actuators.edit_spec(spec)
  parent = mujoco.MjSpec.from_string(chain("other", actuators='<motor name="first" joint="other"/>'))
  parent.attach(spec, prefix="robot/", frame=parent.worldbody.add_frame())
  model = parent.compile()
  actuators.build(model, num_envs=2, device="cpu", dtype=torch.float64, prefix="robot/")
  names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, i) for i in actuators.ctrl_ids]
  assert names == ["robot/spin", "robot/hold", "robot/also_hold", "robot/c"]
  wanted = [command(1, "b"), command(0, "a"), command(0, "b"), expected("pd", "c")]
  assert actuators.compute(*identifiable(JOINTS))[0].tolist() == wanted


def test_wrapping_everything_leaves_added_actuators_to_their_config() -> None:
  model, actuators = wrap("", XmlActuatorCfg(target_names_expr=(".*",)), cfg_for("motor", "c"))
  ctrl = actuators.compute(*identifiable(JOINTS))
  assert dict(zip(actuators.ctrl_ids, ctrl[0].tolist(), strict=True))[model.actuator("c").id] == command(2, "c")
  assert len(actuators.ctrl_ids) == model.nu


def test_ctrl_that_is_not_driven_is_not_touched() -> None:
  ctrl = torch.full((2, 4), -7.0, dtype=torch.float64)
  _, actuators = wrap("", XmlActuatorCfg(target_names_expr=("a", "d")), ctrl=ctrl)
  actuators.compute(*identifiable(JOINTS))
  assert ctrl[0].tolist() == [command(2, "d") / 5.0, -7.0, command(0, "a"), -7.0]


def test_an_actuator_of_unknown_target_needs_a_command_field() -> None:
  own = '<damper name="brake" joint="c" kv="1" ctrlrange="0 1"/>'
  with pytest.raises(ValueError, match="which target actuator 'brake' takes"):
    wrap(own, XmlActuatorCfg(target_names_expr=(".*",)))
  _, actuators = wrap(own, XmlActuatorCfg(target_names_expr=("c",), command_field="effort_target"))
  assert actuators.compute(*identifiable(JOINTS))[0].tolist() == [command(2, "c")]


def test_wrapping_a_joint_without_an_actuator_is_refused_by_name() -> None:
  with pytest.raises(ValueError, match="entity 'x': pattern 'c' matches no joint with an MJCF actuator"):
    wrap("", XmlActuatorCfg(target_names_expr=("c",)))


def test_a_joint_wrapped_twice_is_refused() -> None:
  with pytest.raises(ValueError, match="entity 'x': joint 'a' is driven by two actuator configs"):
    wrap("", XmlActuatorCfg(target_names_expr=("a",)), XmlActuatorCfg(target_names_expr=(".*",)))
