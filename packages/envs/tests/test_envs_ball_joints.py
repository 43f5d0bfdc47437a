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


def test_ids_of_some_joints_are_refused_where_they_are_no_columns(make: Callable[..., Any]) -> None:
  with pytest.raises(ConfigError, match=r"entity 'robot': joint 'neck' has several columns.*elbow"):
    make(robot_cfg("elbow"))


def test_a_ball_joint_is_observed_as_the_rotation_from_its_default(make: Callable[..., Any]) -> None:
  cfg = robot_cfg(None)
  default = np.array([np.cos(0.2), 0.0, np.sin(0.2), 0.0])
  cfg.scene.entities["robot"].init_state.joint_pos = {"neck": tuple(default), "elbow": 0.4}
  env = make(cfg)
  env.reset()
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
