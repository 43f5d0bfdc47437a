"""Each actuator model against its closed form, and the native ones against MuJoCo C."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from actuator_models import build, chain
from mjlab_actuators import (
  ActuatorCfg,
  ActuatorCmd,
  ActuatorSet,
  IdealPd,
  IdealPdActuatorCfg,
  NativeMotorActuatorCfg,
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
)

ARM = """
<mujoco>
  <default><general gear="7" ctrlrange="-0.1 0.1" forcerange="-0.2 0.2"/></default>
  <worldbody>
    <body><geom size="0.1"/><joint name="a" axis="0 1 0" range="-60 90"/>
      <body pos="0 0 1"><geom size="0.1"/><joint name="b" axis="0 1 0"/>
        <body pos="0 0 1"><geom size="0.1"/><joint name="c" type="slide" range="-1 2"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
JOINTS = ["a", "b", "c"]
ALL = (".*",)


def random_command(num_envs: int = 4, n: int = 3, seed: int = 0) -> ActuatorCmd:
  generator = torch.Generator().manual_seed(seed)
  return ActuatorCmd(*(torch.randn(num_envs, n, generator=generator, dtype=torch.float64) for _ in range(5)))


def columns(cmd: ActuatorCmd) -> tuple[torch.Tensor, ...]:
  return cmd.position_target, cmd.velocity_target, cmd.effort_target, cmd.position, cmd.velocity


def make(*cfgs: ActuatorCfg) -> tuple[mujoco.MjModel, ActuatorSet]:
  return build(ARM, *cfgs, owner="entity 'arm'", num_envs=4)


def joint_forces(model: mujoco.MjModel, ctrl: torch.Tensor, cmd: ActuatorCmd) -> np.ndarray:
  """What MuJoCo C makes of one substep's ctrl, (num_envs, nv)."""
  data, forces = mujoco.MjData(model), []
  for world in range(ctrl.shape[0]):
    data.qpos[:], data.qvel[:], data.ctrl[:] = cmd.position[world], cmd.velocity[world], ctrl[world]
    mujoco.mj_forward(model, data)
    forces.append(data.qfrc_actuator.copy())
  return np.array(forces)


def clamped(value: torch.Tensor, limit: float) -> np.ndarray:
  return value.clamp(-limit, limit).numpy()


KP, KD, LIMIT = 3.0, 0.4, 2.0
EVERY_JOINT: dict[str, Any] = {"target_names_expr": ALL}
GAINS: dict[str, Any] = EVERY_JOINT | {"stiffness": KP, "damping": KD}


def servo(**fields: Any) -> ActuatorCfg:
  return NativePositionActuatorCfg(**(GAINS | fields))


def pd(**fields: Any) -> ActuatorCfg:
  return IdealPdActuatorCfg(**(GAINS | fields))


def motor(**fields: Any) -> ActuatorCfg:
  return NativeMotorActuatorCfg(**(EVERY_JOINT | fields))


def speed(**fields: Any) -> ActuatorCfg:
  numbers: dict[str, Any] = EVERY_JOINT | {"damping": KD} | fields
  return NativeVelocityActuatorCfg(**numbers)


MODELS: list[tuple[ActuatorCfg, Callable[[ActuatorCmd], np.ndarray]]] = [
  (servo(effort_limit=LIMIT), lambda c: clamped(KP * (c.position_target - c.position) - KD * c.velocity, LIMIT)),
  (servo(), lambda c: (KP * (c.position_target - c.position) - KD * c.velocity).numpy()),
  (speed(effort_limit=0.3), lambda c: clamped(KD * (c.velocity_target - c.velocity), 0.3)),
  (motor(), lambda c: c.effort_target.numpy()),
  (motor(effort_limit=0.5, gear=-3.0), lambda c: clamped(c.effort_target, 1.5)),
  (
    pd(effort_limit=LIMIT),
    lambda c: clamped(
      KP * (c.position_target - c.position) + KD * (c.velocity_target - c.velocity) + c.effort_target, LIMIT
    ),
  ),
]


@pytest.mark.parametrize(
  ("cfg", "closed_form"), MODELS, ids=lambda x: type(x).__name__ if isinstance(x, ActuatorCfg) else ""
)
def test_mujoco_applies_the_closed_form(cfg: ActuatorCfg, closed_form: Callable[[ActuatorCmd], np.ndarray]) -> None:
  model, actuators = make(cfg)
  cmd = random_command()
  ctrl = actuators.compute(*columns(cmd))
  np.testing.assert_allclose(joint_forces(model, ctrl, cmd), closed_form(cmd), rtol=1e-12, atol=1e-12)


def test_targets_beyond_the_joint_range_are_not_clamped() -> None:
  model, actuators = make(servo(damping=0.0))
  cmd = random_command()
  cmd.position_target.fill_(50.0)
  ctrl = actuators.compute(*columns(cmd))
  np.testing.assert_allclose(joint_forces(model, ctrl, cmd), (KP * (50.0 - cmd.position)).numpy())


def test_the_informational_ctrl_range_is_the_joint_range_widened_to_saturation_in_radians() -> None:
  model, _ = make(servo(stiffness=2.0, damping=0.0, effort_limit=3.0))
  assert not model.actuator_ctrllimited.any()
  np.testing.assert_allclose(model.actuator("a").ctrlrange, [-np.pi / 3 - 1.5, np.pi / 2 + 1.5])
  np.testing.assert_allclose(model.actuator("b").ctrlrange, [0.0, 0.0])
  np.testing.assert_allclose(model.actuator("c").ctrlrange, [-2.5, 3.5])


def test_one_config_gives_each_joint_its_numbers() -> None:
  cfg = servo(
    stiffness={"a": 1.0, "[bc]": 2.0},
    damping={"[ab]": 0.1, "c": 0.2},
    effort_limit={"a": 5.0, "b": 6.0, "c": float("inf")},
    armature={"a": 0.01},
    frictionloss=0.3,
    viscous_damping={"b|c": 0.7},
  )
  model, _ = make(cfg)
  np.testing.assert_array_equal(model.actuator_gainprm[:, 0], [1.0, 2.0, 2.0])
  np.testing.assert_array_equal(-model.actuator_biasprm[:, 2], [0.1, 0.1, 0.2])
  np.testing.assert_array_equal(model.actuator_forcerange[:2], [[-5.0, 5.0], [-6.0, 6.0]])
  np.testing.assert_array_equal(model.actuator_forcelimited, [1, 1, 0])
  np.testing.assert_array_equal(model.dof_armature, [0.01, 0.0, 0.0])
  np.testing.assert_array_equal(model.dof_frictionloss, [0.3, 0.3, 0.3])
  np.testing.assert_array_equal(model.dof_damping, [0.0, 0.7, 0.7])


def test_zero_stiffness_with_an_effort_limit_builds() -> None:
  for cfg in (servo(stiffness=0.0, effort_limit=LIMIT), pd(stiffness=0.0, effort_limit=LIMIT)):
    model, actuators = make(cfg)
    cmd = random_command()
    cmd.velocity_target.zero_()
    cmd.effort_target.zero_()
    forces = joint_forces(model, actuators.compute(*columns(cmd)), cmd)
    np.testing.assert_allclose(forces, clamped(-KD * cmd.velocity, LIMIT), atol=1e-15)


@pytest.mark.parametrize(
  ("cfg", "message"),
  [
    (
      servo(stiffness={"a": 1.0, "b": -2.0, "c": 1.0}, damping=0.0),
      "NativePositionActuatorCfg: stiffness must not be negative, got .*'b': -2.0",
    ),
    (pd(stiffness=1.0, damping=-0.1), "IdealPd.*damping must not be negative, got -0.1"),
    (pd(stiffness=float("nan"), damping=0.1), "stiffness must be a number, got nan"),
    (motor(effort_limit=0.0), "effort_limit must be positive, got 0.0"),
    (speed(damping=1.0, effort_limit=-1.0), "effort_limit must be positive, got -1.0"),
    (motor(armature=-1e-3), "armature must not be negative, got -0.001"),
    (motor(frictionloss={"b": -1.0}), "frictionloss must not be negative, got .*'b': -1.0"),
    (motor(viscous_damping=-1.0), "viscous_damping must not be negative, got -1.0"),
    (motor(gear=0.0), "gear must not be zero, got 0.0"),
    (motor(delay_min_lag=3, delay_max_lag=2), "delay_min_lag 3 exceeds"),
    (motor(delay_min_lag=-1), "delay_min_lag must not be negative, got -1"),
    (motor(delay_max_lag=1, delay_hold_prob=1.5), r"delay_hold_prob must be in \[0, 1\], got 1.5"),
    (motor(delay_update_period=-1), "delay_update_period must not be negative, got -1"),
    (motor(target_names_expr=("elbow",)), "entity 'arm': pattern 'elbow' matches no joint"),
    (servo(stiffness={"a": 1.0}, damping=0.0), "NativePositionActuatorCfg.stiffness"),
  ],
)
def test_impossible_numbers_are_refused_by_name_at_build(cfg: ActuatorCfg, message: str) -> None:
  with pytest.raises(ValueError, match=message):
    make(cfg)


class StifferServoCfg(NativePositionActuatorCfg):
  """A user's own kind of servo."""

  def _numbers(self, target_names, *names):
    rows = super()._numbers(target_names, *names)
    return [{name: (2.0 if name == "stiffness" else 1.0) * value for name, value in row.items()} for row in rows]


def test_a_subclass_of_a_native_config_is_one_too() -> None:
  own = StifferServoCfg(target_names_expr=("a",), stiffness=KP, damping=KD)
  model, actuators = make(own, servo(target_names_expr=("[bc]",)))
  assert len(actuators.groups) == 1
  cmd = random_command()
  got = joint_forces(model, actuators.compute(*columns(cmd)), cmd)
  factor = torch.tensor([2.0, 1.0, 1.0])
  expected = factor * KP * (cmd.position_target - cmd.position) - KD * cmd.velocity
  np.testing.assert_allclose(got, expected.numpy(), rtol=1e-12, atol=1e-12)


def test_a_joint_driven_twice_is_refused() -> None:
  with pytest.raises(ValueError, match="joint 'b' already has an actuator"):
    make(motor(), motor(target_names_expr=("b",)))


def test_a_model_compiled_without_the_actuators_is_refused() -> None:
  actuators = ActuatorSet([motor()])
  with pytest.raises(ValueError, match="no actuator 'a'; call edit_spec before"):
    actuators.build(mujoco.MjModel.from_xml_string(ARM), num_envs=1, device="cpu", dtype=torch.float64)


@pytest.mark.parametrize("configured", [LIMIT, None])
def test_effort_limits_of_each_world_reach_the_joint(configured: float | None) -> None:
  model, actuators = make(pd(stiffness=100.0, damping=0.0, effort_limit=configured))
  cmd = random_command()
  limits = actuators.groups[0].expand("effort_limit")
  limits[0], limits[1] = LIMIT, 1000.0
  forces = joint_forces(model, actuators.compute(*columns(cmd)), cmd)
  free = (100.0 * (cmd.position_target - cmd.position) + cmd.effort_target).numpy()
  np.testing.assert_allclose(forces[0], np.clip(free[0], -LIMIT, LIMIT))
  np.testing.assert_allclose(forces[1], free[1])
  assert np.abs(free[1]).max() > LIMIT


@pytest.mark.parametrize("worlds", [1, 2])
def test_parameters_are_saved_once_they_may_differ_between_worlds(worlds: int) -> None:
  cfg = pd(target_names_expr=("a",), stiffness=1.0, damping=1.0)
  (actuator,) = build(chain("a"), cfg, num_envs=worlds)[1].groups
  assert actuator.state_dict() == {}
  actuator.expand("stiffness")
  assert set(actuator.state_dict()) == {"stiffness"}


def test_expanded_gains_act_in_one_world_and_nominal_ones_stay() -> None:
  _, actuators = make(pd())
  cmd = random_command()
  before = actuators.compute(*columns(cmd)).clone()
  (actuator,) = actuators.groups
  assert isinstance(actuator, IdealPd)
  assert actuator.stiffness.shape == (1, 3)
  stiffness = actuator.expand("stiffness")
  assert stiffness.shape == (4, 3)
  stiffness[2] *= 2.0
  after = actuators.compute(*columns(cmd))
  others = torch.tensor([0, 1, 3])
  assert torch.equal(after[others], before[others])
  torch.testing.assert_close(after[2], before[2] + KP * (cmd.position_target - cmd.position)[2])
  torch.testing.assert_close(actuator.nominal("stiffness"), torch.full((1, 3), KP, dtype=torch.float64))
  assert actuator.expand("stiffness") is stiffness
  with pytest.raises(ValueError, match=r"parameter 'stifness' does not exist. Nearest: stiffness"):
    actuator.expand("stifness")
