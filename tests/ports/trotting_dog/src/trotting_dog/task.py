"""Trot of the Go1 on a plane, with few rewards and many penalties."""

import math

from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import (
  EventTermCfg,
  ObservationGroupCfg,
  ObservationTermCfg,
  RewardTermCfg,
  SceneEntityCfg,
  TerminationTermCfg,
  UniformNoiseCfg,
)
from mjlab_rl import RslRlModelCfg, RslRlOnPolicyRunnerCfg, TaskCfg
from mjlab_robots import go1
from mjlab_scene import SceneCfg
from mjlab_sensors import ContactMatch, ContactSensorCfg
from mjlab_sim import SimulationCfg
from mjlab_terrain import PlaneCfg
from mjlab_velocity import VelocityEvaluation, ground_contact
from mjlab_velocity.mdp import UniformVelocityCommandCfg, VelocityRanges

from trotting_dog import terms

FEET = ("FR", "FL", "RR", "RL")
PERIOD, STANCE = 0.5, 0.55
HIPS = SceneEntityCfg("robot", joint_names=".*_hip_joint")


def trot() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task."""
  agent = RslRlOnPolicyRunnerCfg(experiment_name="trotting_dog", max_iterations=1500, num_steps_per_env=24)
  agent.actor.hidden_dims, agent.critic = (128, 64), RslRlModelCfg(hidden_dims=(128, 64))
  return TaskCfg(env=env(), play=play, agent=agent, evaluator=VelocityEvaluation())


def env() -> ManagerBasedRlEnvCfg:
  """Return the training environment."""
  feet = tuple(f"{foot}_foot_collision" for foot in FEET)
  return ManagerBasedRlEnvCfg(
    decimation=4,
    episode_length_s=20.0,
    sim=SimulationCfg(timestep=0.005, cone="elliptic", impratio=10.0, iterations=10, ls_iterations=20),
    scene=SceneCfg(
      terrain=PlaneCfg(),
      entities={"robot": go1()},
      sensors={
        "feet": ContactSensorCfg(
          primary=ContactMatch(mode="geom", pattern=feet, entity="robot", preserve_order=True),
          secondary=ContactMatch(mode="body", pattern="terrain"),
          fields=("found",),
        ),
        "trunk": ground_contact(ContactMatch(mode="geom", pattern="(trunk|head)_collision", entity="robot")),
      },
    ),
    commands={
      "twist": UniformVelocityCommandCfg(
        ranges=VelocityRanges(lin_vel_x=(-1.0, 1.0), lin_vel_y=(-0.5, 0.5), ang_vel_z=(-1.0, 1.0)),
        resampling_time_range=(10.0, 10.0),
        heading_fraction=0.0,
      )
    },
    actions={"joint_pos": mdp.JointPositionActionCfg(actuators=".*", scale=0.25)},
    observations={"actor": seen(is_critic=False), "critic": seen(is_critic=True)},
    rewards={
      "velocity": RewardTermCfg(terms.velocity_error, weight=1.0, params={"command": "twist", "scale": 0.25}),
      "gait": RewardTermCfg(terms.gait, weight=0.4, params={"sensor": "feet", "period": PERIOD, "stance": STANCE}),
      "height": RewardTermCfg(terms.height_error, weight=-20.0, params={"target": 0.27}),
      "vertical_speed": RewardTermCfg(terms.vertical_speed, weight=-2.0),
      "flat": RewardTermCfg(mdp.flat_orientation_l2, weight=-1.0),
      "hips": RewardTermCfg(terms.hip_deviation, weight=-0.3, params={"hips": HIPS}),
      "joint_acc": RewardTermCfg(mdp.joint_acc_l2, weight=-2.5e-7),
      "joint_limits": RewardTermCfg(mdp.joint_pos_limits, weight=-5.0),
      "effort": RewardTermCfg(mdp.joint_torques_l2, weight=-1e-5),
      "action_rate": RewardTermCfg(mdp.action_rate_l2, weight=-0.01),
    },
    terminations={
      "time_out": TerminationTermCfg(mdp.time_out, time_out=True),
      "trunk": TerminationTermCfg(mdp.illegal_contact, params={"sensor": "trunk", "threshold": 1.0}),
    },
    events={
      "root": EventTermCfg(
        mdp.reset_root_state_uniform,
        mode="reset",
        params={"pose_range": {"z": (0.03, 0.05), "yaw": (-math.pi, math.pi)}},
      ),
      "joints": EventTermCfg(
        mdp.reset_joints_by_offset,
        mode="reset",
        params={"position_range": (-0.1, 0.1), "velocity_range": (0.0, 0.0)},
      ),
    },
  )


def seen(*, is_critic: bool) -> ObservationGroupCfg:
  """Return what a policy observes: no linear velocity; the critic sees it."""
  noise = None if is_critic else UniformNoiseCfg(n_min=-0.02, n_max=0.02)
  terms_ = {
    "turning": ObservationTermCfg(mdp.builtin_sensor, scale=0.25, params={"sensor": "robot/imu_ang_vel"}),
    "gravity": ObservationTermCfg(mdp.projected_gravity, noise=noise),
    "command": ObservationTermCfg(mdp.generated_commands, params={"command": "twist"}),
    "joint_pos": ObservationTermCfg(mdp.joint_pos_rel, noise=noise),
    "joint_vel": ObservationTermCfg(mdp.joint_vel_rel, scale=0.05),
    "actions": ObservationTermCfg(mdp.last_action),
    "clock": ObservationTermCfg(terms.clock, params={"period": PERIOD}),
  }
  speed = {"speed": ObservationTermCfg(mdp.builtin_sensor, params={"sensor": "robot/imu_lin_vel"})}
  return ObservationGroupCfg(corrupt=not is_critic, terms={**(speed if is_critic else {}), **terms_})


def play(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  """Turn the training config into one for watching."""
  cfg.episode_length_s = 1e9
  actor = cfg.observations["actor"]
  if actor is not None:
    actor.corrupt = False
  return cfg
