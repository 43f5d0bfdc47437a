"""Task of standing still on two wheels, with pushes."""

import math

from mjlab_dr import body_mass, geom_friction
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import (
  CurriculumTermCfg,
  EventTermCfg,
  MetricsTermCfg,
  ObservationGroupCfg,
  ObservationTermCfg,
  RewardTermCfg,
  SceneEntityCfg,
  TerminationTermCfg,
  UniformNoiseCfg,
)
from mjlab_rl import RslRlModelCfg, RslRlOnPolicyRunnerCfg, TaskCfg
from mjlab_scene import SceneCfg
from mjlab_sim import SimulationCfg
from mjlab_terrain import PlaneCfg

from wheeled_biped import terms
from wheeled_biped.robot import WHEEL_RADIUS, robot

LEGS = SceneEntityCfg("robot", joint_names=(".*_hip", ".*_knee"))
WHEELS = SceneEntityCfg("robot", joint_names=".*_wheel")
PUSH = {"x": (-0.3, 0.3), "pitch": (-0.4, 0.4)}


def balance() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task."""
  agent = RslRlOnPolicyRunnerCfg(experiment_name="wheeled_biped", max_iterations=500, num_steps_per_env=24)
  agent.actor.hidden_dims, agent.critic = (64, 64), RslRlModelCfg(hidden_dims=(64, 64))
  return TaskCfg(env=env(), play=play, agent=agent)


def env() -> ManagerBasedRlEnvCfg:
  """Return the training environment."""
  return ManagerBasedRlEnvCfg(
    decimation=4,
    episode_length_s=10.0,
    sim=SimulationCfg(timestep=0.005, cone="elliptic", impratio=10.0),
    scene=SceneCfg(terrain=PlaneCfg(), entities={"robot": robot()}),
    actions={
      "legs": mdp.JointPositionActionCfg(actuators=(".*_hip", ".*_knee"), scale=0.25),
      "wheels": mdp.JointVelocityActionCfg(actuators=".*_wheel", scale=10.0, clip={".*": (-50.0, 50.0)}),
    },
    observations={"actor": seen(noisy=True), "critic": seen(noisy=False)},
    rewards={
      "upright": RewardTermCfg(terms.tip_upright, weight=1.0, params={"std": 0.3}),
      "ground_speed": RewardTermCfg(terms.ground_speed, weight=-0.5, params={"wheels": WHEELS, "radius": WHEEL_RADIUS}),
      "drift": RewardTermCfg(terms.drift, weight=-0.2),
      "leg_effort": RewardTermCfg(mdp.joint_torques_l2, weight=-1e-3, params={"asset": LEGS}),
      "action_rate": RewardTermCfg(mdp.action_rate_l2, weight=-0.01),
    },
    terminations={
      "time_out": TerminationTermCfg(mdp.time_out, time_out=True),
      "fell": TerminationTermCfg(mdp.bad_orientation, params={"limit_angle": math.radians(50.0)}),
    },
    events={
      "start": EventTermCfg(
        mdp.reset_root_state_uniform,
        mode="reset",
        params={"pose_range": {"pitch": (-0.1, 0.1), "yaw": (-math.pi, math.pi)}},
      ),
      "joints": EventTermCfg(
        mdp.reset_joints_by_offset,
        mode="reset",
        params={"position_range": (-0.05, 0.05), "velocity_range": (0.0, 0.0), "asset": LEGS},
      ),
      "push": EventTermCfg(
        mdp.push_by_setting_velocity,
        mode="interval",
        interval_range_s=(2.0, 4.0),
        params={"velocity_range": PUSH},
      ),
      "payload": mdp.randomize_at_startup(body_mass("base", (0.9, 1.3), operation="scale")),
      "grip": mdp.randomize_at_startup(geom_friction(".*_tire", (0.6, 1.2), axes=(0,), shared=True)),
    },
    curriculum={
      "hold_place": CurriculumTermCfg(
        mdp.reward_curriculum, params={"reward": "drift", "stages": [mdp.Stage(step=200 * 24, weight=-1.0)]}
      )
    },
    metrics={"drift": MetricsTermCfg(terms.drift, reduce="last")},
  )


def seen(*, noisy: bool) -> ObservationGroupCfg:
  """Return what a policy observes; it does not see where it is."""
  noise = UniformNoiseCfg(n_min=-0.05, n_max=0.05) if noisy else None
  return ObservationGroupCfg(
    corrupt=noisy,
    history_length=2,
    terms={
      "gravity": ObservationTermCfg(mdp.projected_gravity, noise=noise),
      "turning": ObservationTermCfg(mdp.builtin_sensor, params={"sensor": "robot/gyro"}),
      "legs": ObservationTermCfg(mdp.joint_pos_rel, params={"asset": LEGS}),
      "speeds": ObservationTermCfg(mdp.joint_vel_rel, scale=0.1),
      "actions": ObservationTermCfg(mdp.last_action),
    },
  )


def play(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  """Turn the training config into one for watching."""
  cfg.episode_length_s = 1e9
  cfg.events["push"] = None
  return cfg
