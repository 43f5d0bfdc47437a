"""Actions of tendons and sites, compared with MuJoCo C."""

from typing import Any

import mujoco
import numpy as np
import pytest
from envs_hopper import Make, actions
from mjlab_actuators import NativeMotorActuatorCfg, NativePositionActuatorCfg, NativeVelocityActuatorCfg
from mjlab_core.errors import ConfigError
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import ActionTermCfg
from mjlab_scene import EntityArticulationCfg, EntityCfg, SceneCfg
from mjlab_sim import SimulationCfg

# Three tendons across two hinges and a slide; one is called like a joint, and the model has them in another order.
CRANE = """
<mujoco>
  <worldbody>
    <body name="boom">
      <joint name="lift" axis="0 1 0" armature=".1"/>
      <geom size=".05" pos=".3 0 0" mass="1"/>
      <body name="trolley" pos=".3 0 0">
        <joint name="run" type="slide" axis="1 0 0" armature=".1"/>
        <geom size=".05" mass=".5"/>
        <body name="hook" pos="0 0 -.3">
          <joint name="swing" axis="0 1 0" armature=".1"/>
          <geom size=".05" pos="0 0 -.1" mass=".3"/>
          <site name="jet" pos="0 0 -.2" euler="0 20 0"/>
          <site name="eye"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="rope"><joint joint="lift" coef="0.5"/><joint joint="run" coef="1"/></fixed>
    <fixed name="swing"><joint joint="swing" coef="2"/></fixed>
    <fixed name="chain"><joint joint="run" coef="-1"/><joint joint="swing" coef="0.3"/></fixed>
  </tendon>
</mujoco>
"""
UPWARDS = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
ACTUATORS = (
  NativeMotorActuatorCfg(target_names_expr=("chain",), transmission_type="tendon"),
  NativePositionActuatorCfg(target_names_expr=("rope",), transmission_type="tendon", stiffness=40.0, damping=2.0),
  NativeVelocityActuatorCfg(target_names_expr=("swing",), transmission_type="tendon", damping=3.0),
  NativeMotorActuatorCfg(target_names_expr=("jet",), transmission_type="site", site_gear=UPWARDS),
)


def crane(engine: str = "native", /, **terms: ActionTermCfg) -> ManagerBasedRlEnvCfg:
  robot = EntityCfg(
    spec_fn=lambda: mujoco.MjSpec.from_string(CRANE), articulation=EntityArticulationCfg(actuators=ACTUATORS)
  )
  sim: dict[str, Any] = {"engine": engine, "timestep": 0.005, "num_threads": 1, "iterations": 10, "ls_iterations": 20}
  return ManagerBasedRlEnvCfg(
    decimation=2,
    episode_length_s=1.0,
    seed=7,
    scene=SceneCfg(num_envs=4, entities={"robot": robot}),
    sim=SimulationCfg(nconmax=8, njmax=32, **sim),
    actions=dict(terms),
    observations={},
    rewards={},
    terminations={},
  )


def test_each_target_moves_the_crane_as_in_mujoco(make: Make, engine: str) -> None:
  cfg = crane(
    engine,
    rope=mdp.TendonLengthActionCfg(actuators="rope", scale=0.2, offset=0.1),
    swing=mdp.TendonVelocityActionCfg(actuators="swing", scale={"swing": 2.0}),
    chain=mdp.TendonEffortActionCfg(actuators="chain", scale=3.0, clip=(-1.0, 2.0)),
    jet=mdp.SiteEffortActionCfg(scale=4.0, clip={"jet": (0.0, 5.0)}),
  )
  env = make(cfg)
  model: mujoco.MjModel = env.sim.mj_model
  worlds = [mujoco.MjData(model) for _ in range(4)]
  for world, data in enumerate(worlds):
    data.qpos[:], data.qvel[:] = env.sim.data.qpos[world], env.sim.data.qvel[world]
  columns = [model.actuator(f"robot/{name}").id for name in ("rope", "swing", "chain", "jet")]
  for step in range(3):
    action = actions(env, step)
    env.step(action)
    a = action.double().numpy()
    wanted = np.stack(
      (0.2 * a[:, 0] + 0.1, 2.0 * a[:, 1], np.clip(3.0 * a[:, 2], -1.0, 2.0), (4.0 * a[:, 3]).clip(0, 5))
    )
    for world, data in enumerate(worlds):
      data.ctrl[columns] = wanted[:, world]
      mujoco.mj_step(model, data, cfg.decimation)
  expected = np.array([data.qpos for data in worlds])
  assert np.abs(expected).max() > 0.01
  np.testing.assert_allclose(env.sim.data.qpos.double().numpy(), expected, atol=1e-12 if engine == "native" else 1e-5)


def test_a_tendon_that_is_called_like_a_joint_is_driven_as_a_tendon(make: Make) -> None:
  cfg = crane(swing=mdp.TendonVelocityActionCfg(actuators="swing"), rope=mdp.TendonLengthActionCfg(actuators="rope"))
  env = make(cfg)
  assert env.action_manager.get_term("swing").driven == {"robot/tendon swing"}


@pytest.mark.parametrize(
  ("terms", "message"),
  [
    ({"a": mdp.TendonLengthActionCfg(actuators="rop")}, "no actuated tendon.*rope"),
    ({"a": mdp.SiteEffortActionCfg(actuators="eye")}, "no actuated site.*jet"),
    ({"a": mdp.JointEffortActionCfg(actuators="swing")}, "actuated joint"),
    ({"a": mdp.TendonEffortActionCfg(scale={"rop.": 1.0})}, "tendon"),
    (
      {"a": mdp.TendonLengthActionCfg(actuators="rope"), "b": mdp.TendonEffortActionCfg()},
      "terms 'a' and 'b' both drive robot/tendon rope",
    ),
  ],
)
def test_a_mistake_is_named_at_build(make: Make, terms: dict[str, ActionTermCfg], message: str) -> None:
  with pytest.raises(ConfigError, match=message):
    make(crane(**terms))
