"""Robots with a joint of several columns: ids of joints are then not columns of their positions."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_actuators import NativePositionActuatorCfg
from mjlab_core.errors import ConfigError
from mjlab_dr import encoder_bias
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import EventTermCfg, ObservationGroupCfg, ObservationTermCfg, SceneEntityCfg
from mjlab_scene import EntityArticulationCfg, EntityCfg, InitialStateCfg, SceneCfg
from mjlab_sim import SimulationCfg

ROBOT = """
<mujoco><worldbody><body name="head"><joint name="neck" type="ball"/><geom size=".1"/>
  <body name="arm" pos="0 0 .3"><joint name="elbow" axis="0 1 0"/><geom size=".1"/></body>
</body></worldbody></mujoco>
"""


def robot_cfg(joints: str | None) -> ManagerBasedRlEnvCfg:
  servo = NativePositionActuatorCfg(target_names_expr=("elbow",), stiffness=10.0, damping=1.0)
  entity = EntityCfg(
    spec_fn=lambda: mujoco.MjSpec.from_string(ROBOT),
    init_state=InitialStateCfg(joint_pos={"elbow": 0.4}),
    articulation=EntityArticulationCfg(actuators=(servo,)),
  )
  asset = SceneEntityCfg("robot", joint_names=joints)
  return ManagerBasedRlEnvCfg(
    decimation=1,
    episode_length_s=1.0,
    scene=SceneCfg(num_envs=2, entities={"robot": entity}),
    sim=SimulationCfg(num_threads=1),
    actions={"arm": mdp.JointPositionActionCfg()},
    observations={
      "actor": ObservationGroupCfg(terms={"joints": ObservationTermCfg(mdp.joint_pos_rel, params={"asset": asset})})
    },
    events={"bias": EventTermCfg(mdp.randomize, mode="startup", params={"randomizer": encoder_bias(".*", (0.1, 0.2))})},
  )


def test_actions_and_encoder_bias_find_the_columns_of_their_joint(make: Callable[..., Any]) -> None:
  env = make(robot_cfg(None))
  bias = env.scene["robot"].data.encoder_bias
  assert bias[:, :4].eq(0).all()
  assert bias[:, 4].ge(0.1).all()
  env.reset()
  env.step(torch.full((2, 1), 0.5))
  np.testing.assert_allclose(env.scene["robot"].data.joint_pos_target[:, 4], 0.4 + 0.5 - bias[:, 4])


def test_ids_of_some_joints_are_refused_as_columns(make: Callable[..., Any]) -> None:
  def own_term(env: Any, *, asset: SceneEntityCfg) -> torch.Tensor:
    return env.scene[asset.name].data.joint_pos[:, asset.joint_ids]

  cfg = robot_cfg("elbow")
  asset = {"asset": SceneEntityCfg("robot", joint_names="elbow")}
  group = cfg.observations["actor"]
  assert group is not None
  group.terms["own"] = ObservationTermCfg(own_term, params=asset)
  with pytest.raises(ConfigError, match=r"joint 'neck' has several columns.*joint_pos_ids"):
    make(cfg)


def test_some_joints_of_a_robot_with_a_ball_joint_are_selected(make: Callable[..., Any]) -> None:
  for joints, v in (("elbow", [3]), ("neck", [0, 1, 2])):
    cfg = robot_cfg(joints)
    asset = {"asset": SceneEntityCfg("robot", joint_names=joints)}
    group = cfg.observations["actor"]
    assert group is not None
    group.terms["velocity"] = ObservationTermCfg(mdp.joint_vel_rel, params=asset)
    if joints == "elbow":
      draw = {"position_range": (0.3, 0.3), "velocity_range": (0.7, 0.7)} | asset
      cfg.events["offset"] = EventTermCfg(mdp.reset_joints_by_offset, mode="reset", params=draw)
    env = make(cfg)
    data = env.scene["robot"].data
    expected = data.joint_pos[:, [4]] - 0.4 if joints == "elbow" else torch.zeros(2, 3)
    if joints == "elbow":
      np.testing.assert_allclose(data.joint_pos[:, 4], 0.7)
      np.testing.assert_allclose(data.joint_vel[:, 3], 0.7)
    data.joint_vel.copy_(torch.arange(8.0).reshape(2, 4))
    seen = env.observation_manager.compute()["actor"]
    np.testing.assert_allclose(seen, torch.cat((expected, data.joint_vel[:, v]), 1), atol=1e-6)
    selection = asset["asset"].resolve(env.scene, env.device)
    assert torch.equal(mdp.joint_vel_l2(env, asset=selection), data.joint_vel[:, v].square().sum(1))
    assert mdp.joint_pos_limits(env, asset=selection).eq(0).all()


def test_a_quaternion_takes_no_offsets(make: Callable[..., Any]) -> None:
  cfg = robot_cfg(None)
  draw = {"position_range": (0.0, 0.1), "velocity_range": (0.0, 0.0)}
  cfg.events["offset"] = EventTermCfg(mdp.reset_joints_by_offset, mode="reset", params=draw)
  with pytest.raises(ConfigError, match="that of ball joint 'neck', takes no offsets"):
    make(cfg)


def test_a_ball_joint_is_observed_as_the_rotation_from_its_default(make: Callable[..., Any]) -> None:
  cfg = robot_cfg(None)
  default = np.array([np.cos(0.2), 0.0, np.sin(0.2), 0.0])
  cfg.scene.entities["robot"].init_state.joint_pos = {"neck": tuple(default), "elbow": 0.4}
  env = make(cfg)
  rng = np.random.default_rng(2)
  quats = rng.normal(size=(2, 4))
  quats /= np.linalg.norm(quats, axis=1, keepdims=True)
  env.sim.data.qpos[:, :4] = torch.tensor(quats)
  env.sim.data.qpos[:, 4] = torch.tensor([0.1, 0.9])
  seen = env.observation_manager.compute()["actor"].double().numpy()
  for world in range(2):
    expected = np.zeros(3)
    mujoco.mju_subQuat(expected, quats[world], default)
    np.testing.assert_allclose(seen[world], [*expected, env.sim.data.qpos[world, 4] - 0.4], atol=1e-5)
