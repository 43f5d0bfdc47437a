"""Cartpole tasks: keep a pole upright, or swing it up first."""

import math
from importlib.resources import files

import mujoco
from mjlab_actuators import XmlActuatorCfg
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import (
  EventTermCfg,
  ObservationGroupCfg,
  ObservationTermCfg,
  RewardTermCfg,
  SceneEntityCfg,
  TerminationTermCfg,
)
from mjlab_rl import (
  OffPolicyRunnerCfg,
  RslRlBaseRunnerCfg,
  RslRlOnPolicyRunnerCfg,
  RslRlPpoAlgorithmCfg,
  TaskCfg,
)
from mjlab_rl.offpolicy import PRESETS
from mjlab_scene import EntityArticulationCfg, EntityCfg, InitialStateCfg, SceneCfg
from mjlab_sim import SimulationCfg

from mjlab_cartpole.evaluation import CartpoleEvaluation
from mjlab_cartpole.terms import joint_angle_cos_sin, smooth_balance

# Timing
PHYSICS_DT = 0.01  # s
DECIMATION = 5
EPISODE_LENGTH = 50.0  # s
FORCE = 10.0  # N per unit of action

# Start of episodes: ranges about the default pose [m, rad]
BALANCE_SLIDER, SWINGUP_SLIDER = (-0.1, 0.1), (0.0, 0.0)
HINGE = (-0.034, 0.034)
VELOCITY = (-0.01, 0.01)


def cartpole_spec() -> mujoco.MjSpec:
  """Return the spec of the cart on its rail and the pole on the cart."""
  return mujoco.MjSpec.from_string(files("mjlab_cartpole").joinpath("cartpole.xml").read_text())


def balance() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of keeping the pole upright."""
  return _task(_env(hinge=0.0, slider_range=BALANCE_SLIDER))


def swingup() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of swinging the pole up and keeping it upright."""
  return _task(_env(hinge=math.pi, slider_range=SWINGUP_SLIDER))


def _task(env: ManagerBasedRlEnvCfg) -> TaskCfg[ManagerBasedRlEnvCfg]:
  # Small networks and batches suit a CPU and few worlds.
  agents: dict[str, RslRlBaseRunnerCfg] = {name: _small(preset(_agent())) for name, preset in PRESETS.items()}
  return TaskCfg(env=env, play=_play, agent=_agent(), agents=agents, evaluator=CartpoleEvaluation())


def _env(*, hinge: float, slider_range: tuple[float, float]) -> ManagerBasedRlEnvCfg:
  return ManagerBasedRlEnvCfg(
    decimation=DECIMATION,
    episode_length_s=EPISODE_LENGTH,
    sim=SimulationCfg(timestep=PHYSICS_DT, iterations=100, ls_iterations=50),
    scene=SceneCfg(
      env_spacing=6.0,
      entities={
        "cartpole": EntityCfg(
          spec_fn=cartpole_spec,
          init_state=InitialStateCfg(joint_pos={"slider": 0.0, "hinge": hinge}),
          articulation=EntityArticulationCfg(actuators=(XmlActuatorCfg(target_names_expr=("slider",)),)),
        )
      },
    ),
    actions={"effort": mdp.JointEffortActionCfg(entity="cartpole", actuators="slider", scale=FORCE)},
    observations={"actor": _observations(), "critic": _observations()},
    rewards={"smooth_balance": RewardTermCfg(smooth_balance, weight=1.0, params={"asset": SceneEntityCfg("cartpole")})},
    terminations={"time_out": TerminationTermCfg(mdp.time_out, time_out=True)},
    events={
      "reset_base": EventTermCfg(mdp.reset_scene_to_default, mode="reset"),
      "reset_slider": _reset("slider", slider_range),
      "reset_hinge": _reset("hinge", HINGE),
    },
  )


def _joint(name: str) -> SceneEntityCfg:
  return SceneEntityCfg("cartpole", joint_names=name)


def _reset(joint: str, position: tuple[float, float]) -> EventTermCfg:
  params = {"position_range": position, "velocity_range": VELOCITY, "asset": _joint(joint)}
  return EventTermCfg(mdp.reset_joints_by_offset, mode="reset", params=params)


def _observations() -> ObservationGroupCfg:
  return ObservationGroupCfg(
    terms={
      "cart_pos": ObservationTermCfg(mdp.joint_pos_rel, params={"asset": _joint("slider")}),
      "pole_angle": ObservationTermCfg(joint_angle_cos_sin, params={"asset": _joint("hinge")}),
      "cart_vel": ObservationTermCfg(mdp.joint_vel_rel, params={"asset": _joint("slider")}),
      "pole_vel": ObservationTermCfg(mdp.joint_vel_rel, params={"asset": _joint("hinge")}),
    }
  )


def _play(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  """Turn a training config into one for watching: endless episodes."""
  cfg.episode_length_s = 1e10
  return cfg


def _agent() -> RslRlOnPolicyRunnerCfg:
  agent = RslRlOnPolicyRunnerCfg(
    experiment_name="cartpole",
    algorithm=RslRlPpoAlgorithmCfg(entropy_coef=0.01),
    num_steps_per_env=32,
    max_iterations=500,
    save_interval=50,
  )
  agent.actor.hidden_dims = agent.critic.hidden_dims = (64, 64)
  return agent


def _small(agent: OffPolicyRunnerCfg) -> OffPolicyRunnerCfg:
  agent.actor.hidden_dims = agent.critic.hidden_dims = (32, 32)
  agent.num_steps_per_env, agent.max_iterations, agent.save_interval, agent.save_replay = 50, 200, 20, True
  algorithm = agent.algorithm
  algorithm.batch_size, algorithm.learning_rate, algorithm.learning_starts = 128, 1e-3, 20
  algorithm.updates_per_step, algorithm.policy_every, algorithm.tau, algorithm.gamma = 2.0, 2, 0.1, 0.97
  # Rewards are small, so returns are brought to the values of the critic.
  algorithm.return_scaling, algorithm.value_limit = True, 5.0
  return agent
