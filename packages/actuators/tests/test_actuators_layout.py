"""Every set-point arrives at its own ctrl, whatever the order of configs, elements and joints."""

import itertools

import mujoco
import numpy as np
import pytest
import torch
from mjlab_actuators import (
  ActuatorCfg,
  ActuatorSet,
  IdealPdActuatorCfg,
  NativeMotorActuatorCfg,
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
  XmlActuatorCfg,
)

CHAIN = """
<mujoco>
  <worldbody>
    <body><geom size="0.1"/><joint name="a"/>
      <body><geom size="0.1"/><joint name="b"/>
        <body><geom size="0.1"/><joint name="c"/>
          <body><geom size="0.1"/><joint name="d"/></body></body></body></body>
  </worldbody>
</mujoco>
"""
JOINTS = ("a", "b", "c", "d")


def command(field: int, joint: str) -> float:
  """A number that says whose it is: 10.0 is the position target of a, 33.0 the effort target of d."""
  return 10.0 * (field + 1) + JOINTS.index(joint)


def identifiable(order: tuple[str, ...], num_envs: int = 2) -> list[torch.Tensor]:
  zeros = torch.zeros(num_envs, len(order), dtype=torch.float64)
  rows = [torch.tensor([command(f, j) for j in order], dtype=torch.float64).repeat(num_envs, 1) for f in range(3)]
  return [*rows, zeros, zeros]


def cfg_for(kind: str, *joints: str, lag: int = 0) -> ActuatorCfg:
  if kind == "position":
    return NativePositionActuatorCfg(
      target_names_expr=joints, stiffness=1.0, damping=0.0, delay_min_lag=lag, delay_max_lag=lag
    )
  if kind == "velocity":
    return NativeVelocityActuatorCfg(target_names_expr=joints, damping=1.0, delay_min_lag=lag, delay_max_lag=lag)
  if kind == "motor":
    return NativeMotorActuatorCfg(target_names_expr=joints, delay_min_lag=lag, delay_max_lag=lag)
  return IdealPdActuatorCfg(target_names_expr=joints, stiffness=1.0, damping=0.0, delay_min_lag=lag, delay_max_lag=lag)


def expected(kind: str, joint: str) -> float:
  fields = {"position": (0,), "velocity": (1,), "motor": (2,), "pd": (0, 2)}[kind]
  return sum(command(field, joint) for field in fields)


@pytest.mark.parametrize("kinds", list(itertools.permutations(["position", "velocity", "motor", "pd"])))
@pytest.mark.parametrize("lag", [0, 2])
def test_each_ctrl_gets_the_set_point_of_its_own_joint(kinds: tuple[str, ...], lag: int) -> None:
  for order in (JOINTS, ("c", "a", "d", "b")):
    assignment = dict(zip(("b", "d", "a", "c"), kinds, strict=True))
    spec = mujoco.MjSpec.from_string(CHAIN)
    actuators = ActuatorSet([cfg_for(kind, joint, lag=lag) for joint, kind in assignment.items()])
    actuators.edit_spec(spec)
    model = spec.compile()
    ctrl = torch.full((2, model.nu), -1.0, dtype=torch.float64)
    actuators.build(model, target_names=order, num_envs=2, device="cpu", dtype=torch.float64, ctrl=ctrl)
    actuators.compute(*identifiable(order))
    for joint, kind in assignment.items():
      index = model.actuator(joint).id
      assert model.actuator_trnid[index, 0] == model.joint(joint).id
      assert ctrl[:, index].tolist() == [expected(kind, joint)] * 2, (joint, kind)


@pytest.mark.parametrize("kind", ["position", "velocity", "motor", "pd"])
def test_configs_of_one_law_are_one_computation_in_every_order(kind: str) -> None:
  for parts in itertools.permutations([("a", "d"), ("b",), ("c",)]):
    spec = mujoco.MjSpec.from_string(CHAIN)
    actuators = ActuatorSet([cfg_for(kind, *joints) for joints in parts])
    actuators.edit_spec(spec)
    model = spec.compile()
    actuators.build(model, num_envs=2, device="cpu", dtype=torch.float64)
    assert len(actuators.groups) == 1
    ctrl = actuators.compute(*identifiable(JOINTS))
    assert actuators.ctrl_targets == tuple(model.actuator(i).name for i in range(model.nu))
    assert ctrl[0].tolist() == [expected(kind, name) for name in actuators.ctrl_targets]


def test_two_motor_types_may_be_one_config_or_two() -> None:
  whole = [IdealPdActuatorCfg(target_names_expr=(".*",), stiffness={"[ac]": 1.0, "[bd]": 2.0}, damping=0.0)]
  split = [
    IdealPdActuatorCfg(target_names_expr=("b", "d"), stiffness=2.0, damping=0.0),
    IdealPdActuatorCfg(target_names_expr=("a", "c"), stiffness=1.0, damping=0.0),
  ]
  results = []
  for cfgs in (whole, split):
    spec = mujoco.MjSpec.from_string(CHAIN)
    actuators = ActuatorSet(cfgs)
    actuators.edit_spec(spec)
    actuators.build(spec.compile(), num_envs=2, device="cpu", dtype=torch.float64)
    ctrl = actuators.compute(*identifiable(JOINTS))
    results.append(dict(zip(actuators.ctrl_targets, ctrl[0].tolist(), strict=True)))
  assert results[0] == results[1]


def test_different_delays_are_different_computations() -> None:
  spec = mujoco.MjSpec.from_string(CHAIN)
  actuators = ActuatorSet([cfg_for("pd", "a"), cfg_for("pd", "b", lag=1), cfg_for("pd", "c", "d", lag=1)])
  actuators.edit_spec(spec)
  actuators.build(spec.compile(), num_envs=2, device="cpu", dtype=torch.float64)
  assert [law.target_names for law in actuators.groups] == [("a",), ("b", "c", "d")]


WRAPPED = """
<mujoco>
  <worldbody>
    <body><geom size="0.1"/><joint name="a"/>
      <body><geom size="0.1"/><joint name="b"/>
        <body><geom size="0.1"/><joint name="c"/>
          <body><geom size="0.1"/><joint name="d"/></body></body></body></body>
  </worldbody>
  <actuator>
    <motor name="push" joint="d" gear="5" ctrlrange="-1 1"/>
    <velocity name="spin" joint="b" kv="2"/>
    <position name="hold" joint="a" kp="3" dampratio="1" ctrlrange="-30 30"/>
    <general name="also_hold" joint="b" gainprm="4" biastype="affine" biasprm="0 -4 -1"/>
    %s
  </actuator>
</mujoco>
"""


def wrap(xml: str, *cfgs: ActuatorCfg, prefix: str = "") -> tuple[mujoco.MjModel, ActuatorSet]:
  spec = mujoco.MjSpec.from_string(xml)
  actuators = ActuatorSet(cfgs, "entity 'x'")
  actuators.edit_spec(spec)
  if prefix:
    parent = mujoco.MjSpec()
    other = parent.worldbody.add_body(name="other")
    other.add_geom(size=[0.1, 0, 0])
    other.add_joint(name="other")
    parent.add_actuator(name="first", target="other", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    parent.attach(spec, prefix=prefix, frame=parent.worldbody.add_frame())
    spec = parent
  model = spec.compile()
  return model, actuators.build(
    model, target_names=JOINTS, num_envs=2, device="cpu", dtype=torch.float64, prefix=prefix
  )


def test_wrapped_actuators_take_the_set_point_that_their_law_asks_for() -> None:
  xml = WRAPPED % '<intvelocity name="creep" joint="c" kp="2" actrange="-1 1"/>'
  plain = mujoco.MjModel.from_xml_string(xml)
  model, actuators = wrap(xml, XmlActuatorCfg(target_names_expr=(".*",)))
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


def test_a_pid_with_several_inputs_takes_one_set_point_each() -> None:
  xml = WRAPPED % '<pid name="all" joint="c" kp="2" kv="1" input="pos vel ff"/>'
  model, actuators = wrap(xml, XmlActuatorCfg(target_names_expr=("c",)))
  assert model.actuator("all").id == 4
  assert actuators.ctrl_ids == (4, 5, 6)
  assert actuators.compute(*identifiable(JOINTS))[0].tolist() == [command(field, "c") for field in range(3)]


@pytest.mark.parametrize(
  ("inputs", "fields"), [("", [2]), ('input="pos" controller="3"', [0]), ('input="pos vel" controller="3 0 1"', [0, 1])]
)
def test_a_dc_motor_of_the_mjcf_takes_its_voltage_or_what_its_controller_follows(
  inputs: str, fields: list[int]
) -> None:
  xml = WRAPPED % f'<dcmotor name="m" joint="c" motorconst="0.5" resistance="2" {inputs}/>'
  _, actuators = wrap(xml, XmlActuatorCfg(target_names_expr=("c",)))
  assert actuators.compute(*identifiable(JOINTS))[0].tolist() == [command(field, "c") for field in fields]


def test_a_prefix_and_other_entities_in_the_model_change_nothing() -> None:
  cfgs = (XmlActuatorCfg(target_names_expr=("a", "b")), cfg_for("pd", "c"))
  model, actuators = wrap(WRAPPED % "", *cfgs, prefix="robot/")
  names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, i) for i in actuators.ctrl_ids]
  assert names == ["robot/spin", "robot/hold", "robot/also_hold", "robot/c"]
  wanted = [command(1, "b"), command(0, "a"), command(0, "b"), expected("pd", "c")]
  assert actuators.compute(*identifiable(JOINTS))[0].tolist() == wanted


def test_wrapping_everything_leaves_added_actuators_to_their_own_config() -> None:
  model, actuators = wrap(WRAPPED % "", XmlActuatorCfg(target_names_expr=(".*",)), cfg_for("motor", "c"))
  ctrl = actuators.compute(*identifiable(JOINTS))
  assert dict(zip(actuators.ctrl_ids, ctrl[0].tolist(), strict=True))[model.actuator("c").id] == command(2, "c")
  assert len(actuators.ctrl_ids) == model.nu


def test_ctrl_that_is_not_driven_is_not_touched() -> None:
  spec = mujoco.MjSpec.from_string(WRAPPED % "")
  actuators = ActuatorSet([XmlActuatorCfg(target_names_expr=("a", "d"))])
  actuators.edit_spec(spec)
  model = spec.compile()
  ctrl = torch.full((2, model.nu), -7.0, dtype=torch.float64)
  actuators.build(model, num_envs=2, device="cpu", dtype=torch.float64, ctrl=ctrl)
  actuators.compute(*identifiable(JOINTS))
  assert ctrl[0].tolist() == [command(2, "d") / 5.0, -7.0, command(0, "a"), -7.0]


def test_an_actuator_whose_set_point_cannot_be_told_is_refused_until_it_is_said() -> None:
  xml = WRAPPED % '<damper name="brake" joint="c" kv="1" ctrlrange="0 1"/>'
  with pytest.raises(ValueError, match="which target actuator 'brake' takes"):
    wrap(xml, XmlActuatorCfg(target_names_expr=(".*",)))
  _, actuators = wrap(xml, XmlActuatorCfg(target_names_expr=("c",), command_field="effort_target"))
  assert actuators.compute(*identifiable(JOINTS))[0].tolist() == [command(2, "c")]


def test_wrapping_a_joint_without_an_actuator_is_refused_by_name() -> None:
  with pytest.raises(ValueError, match="entity 'x': pattern 'c' matches no joint with an MJCF actuator"):
    wrap(WRAPPED % "", XmlActuatorCfg(target_names_expr=("c",)))


def test_a_joint_wrapped_twice_is_refused() -> None:
  with pytest.raises(ValueError, match="entity 'x': joint 'a' is driven by two actuator configs"):
    wrap(WRAPPED % "", XmlActuatorCfg(target_names_expr=("a",)), XmlActuatorCfg(target_names_expr=(".*",)))
