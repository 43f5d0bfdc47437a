"""Tracking tasks of the Unitree G1 on a plane."""

import copy
from collections.abc import Callable
from typing import Any, TypeVar

from mjlab_dr import body_com_offset, encoder_bias, geom_friction
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import (
  EventTermCfg,
  MetricsTermCfg,
  ObservationGroupCfg,
  ObservationTermCfg,
  RewardTermCfg,
  TerminationTermCfg,
  UniformNoiseCfg,
)
from mjlab_rl import RslRlModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg, TaskCfg
from mjlab_robots import G1_ACTION_SCALE, g1
from mjlab_scene import SceneCfg
from mjlab_sensors import ContactMatch, ContactSensorCfg
from mjlab_sim import SimulationCfg
from mjlab_terrain import PlaneCfg

from mjlab_tracking import mdp as tracking
from mjlab_tracking.evaluation import TrackingEvaluation

T = TypeVar("T")

# Timing
PHYSICS_DT = 0.005  # s
DECIMATION = 4
EPISODE_LENGTH = 10.0  # s

# The motion
MOTION = "squat_and_wave"
ANCHOR = "torso_link"
BODIES = (
  "pelvis",
  "left_hip_roll_link",
  "left_knee_link",
  "left_ankle_roll_link",
  "right_hip_roll_link",
  "right_knee_link",
  "right_ankle_roll_link",
  "torso_link",
  "left_shoulder_roll_link",
  "left_elbow_link",
  "left_wrist_yaw_link",
  "right_shoulder_roll_link",
  "right_elbow_link",
  "right_wrist_yaw_link",
)
END_EFFECTORS = ("left_ankle_roll_link", "right_ankle_roll_link", "left_wrist_yaw_link", "right_wrist_yaw_link")

# How far a start is from its frame [m, rad, m/s, rad/s]; pushes are as strong as velocities are off.
POSE = {
  "x": (-0.05, 0.05),
  "y": (-0.05, 0.05),
  "z": (-0.01, 0.01),
  "roll": (-0.1, 0.1),
  "pitch": (-0.1, 0.1),
  "yaw": (-0.2, 0.2),
}
VELOCITY = {
  "x": (-0.5, 0.5),
  "y": (-0.5, 0.5),
  "z": (-0.2, 0.2),
  "roll": (-0.52, 0.52),
  "pitch": (-0.52, 0.52),
  "yaw": (-0.78, 0.78),
}
JOINT_POSITION = (-0.1, 0.1)  # rad
PUSH_INTERVAL = (1.0, 3.0)  # s

# When it is lost
MAX_HEIGHT_ERROR = 0.25  # m, of the anchor, hands and feet
MAX_TILT_ERROR = 0.8  # difference of gravity's z in both anchors

# Noise of what the policy sees
NOISE_ANCHOR_POS = UniformNoiseCfg(n_min=-0.25, n_max=0.25)
NOISE_ANCHOR_ORI = UniformNoiseCfg(n_min=-0.05, n_max=0.05)
NOISE_LIN_VEL = UniformNoiseCfg(n_min=-0.5, n_max=0.5)
NOISE_ANG_VEL = UniformNoiseCfg(n_min=-0.2, n_max=0.2)
NOISE_JOINT_POS = UniformNoiseCfg(n_min=-0.01, n_max=0.01)
NOISE_JOINT_VEL = UniformNoiseCfg(n_min=-0.5, n_max=0.5)


def g1_flat() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of following a clip with state estimation."""
  return TaskCfg(env=g1_flat_env(), play=play, agent=agent(), evaluator=evaluator())


def g1_flat_no_state_estimation() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of following a clip without position and linear velocity of the base."""
  cfg = g1_flat_env()
  actor = cfg.observations["actor"]
  assert actor is not None
  for name in ("motion_anchor_pos_b", "base_lin_vel"):
    del actor.terms[name]
  return TaskCfg(env=cfg, play=play, agent=agent(), evaluator=evaluator())


def g1_flat_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment; each call returns an independent copy."""
  cfg = ManagerBasedRlEnvCfg(
    decimation=DECIMATION,
    episode_length_s=EPISODE_LENGTH,
    sim=SimulationCfg(
      timestep=PHYSICS_DT,
      cone="pyramidal",
      impratio=1.0,
      iterations=10,
      ls_iterations=20,
      ccd_iterations=50,
      nconmax=48,
      njmax=256,
    ),
    scene=SceneCfg(
      terrain=PlaneCfg(), entities={"robot": g1()}, sensors={"self_collision": _self_collision()}, extent=2.0
    ),
    actions={"joint_pos": mdp.JointPositionActionCfg(entity="robot", actuators=".*", scale=dict(G1_ACTION_SCALE))},
    commands={
      "motion": tracking.MotionCommandCfg(
        motion=MOTION,
        anchor_body=ANCHOR,
        bodies=BODIES,
        pose_range=dict(POSE),
        velocity_range=dict(VELOCITY),
        joint_position_range=JOINT_POSITION,
      )
    },
    observations={"actor": _actor(), "critic": _critic()},
    rewards=_rewards(),
    terminations=_terminations(),
    events=_events(),
    metrics={
      f"error_{quantity}": MetricsTermCfg(tracking.motion_error, params={"command": "motion", "quantity": quantity})
      for quantity in tracking.QUANTITIES
    },
  )
  # Constants and arguments stay behind; and term by term, so that not even two terms of it share a part.
  for group in cfg.observations.values():
    if group is not None:
      group.terms = _apart(group.terms)
  cfg.events = _apart(cfg.events)
  return cfg


def _apart(terms: dict[str, T]) -> dict[str, T]:
  return {name: copy.deepcopy(term) for name, term in terms.items()}


def _self_collision() -> ContactSensorCfg:
  """Return the sensor of the strongest self-contact in each substep."""
  robot = ContactMatch(mode="subtree", pattern="pelvis", entity="robot")
  return ContactSensorCfg(
    primary=robot,
    secondary=copy.deepcopy(robot),
    fields=("found", "force"),
    reduce="maxforce",
    history_length="decimation",
  )


def _actor() -> ObservationGroupCfg:
  motion = {"command": "motion"}
  return ObservationGroupCfg(
    corrupt=True,
    terms={
      "command": ObservationTermCfg(mdp.generated_commands, params=motion),
      "motion_anchor_pos_b": ObservationTermCfg(tracking.motion_anchor_pos_b, noise=NOISE_ANCHOR_POS, params=motion),
      "motion_anchor_ori_b": ObservationTermCfg(tracking.motion_anchor_ori_b, noise=NOISE_ANCHOR_ORI, params=motion),
      "base_lin_vel": ObservationTermCfg(
        mdp.builtin_sensor, noise=NOISE_LIN_VEL, params={"sensor": "robot/imu_lin_vel"}
      ),
      "base_ang_vel": ObservationTermCfg(
        mdp.builtin_sensor, noise=NOISE_ANG_VEL, params={"sensor": "robot/imu_ang_vel"}
      ),
      "joint_pos": ObservationTermCfg(mdp.joint_pos_rel, noise=NOISE_JOINT_POS, params={"biased": True}),
      "joint_vel": ObservationTermCfg(mdp.joint_vel_rel, noise=NOISE_JOINT_VEL),
      "actions": ObservationTermCfg(mdp.last_action),
    },
  )


def _critic() -> ObservationGroupCfg:
  group = _actor()
  group.corrupt = False
  motion = {"command": "motion"}
  terms = dict(group.terms)
  terms["joint_pos"] = ObservationTermCfg(mdp.joint_pos_rel)
  before = ("command", "motion_anchor_pos_b", "motion_anchor_ori_b")
  group.terms = {
    **{name: terms[name] for name in before},
    "body_pos": ObservationTermCfg(tracking.robot_body_pos_b, params=motion),
    "body_ori": ObservationTermCfg(tracking.robot_body_ori_b, params=motion),
    **{name: term for name, term in terms.items() if name not in before},
  }
  return group


def _rewards() -> dict[str, RewardTermCfg | None]:
  def kernel(func: Callable[..., Any], weight: float, std: float) -> RewardTermCfg:
    return RewardTermCfg(func, weight=weight, params={"command": "motion", "std": std})

  return {
    "motion_global_root_pos": kernel(tracking.motion_global_root_pos, 0.5, 0.3),
    "motion_global_root_ori": kernel(tracking.motion_global_root_ori, 0.5, 0.4),
    "motion_body_pos": kernel(tracking.motion_body_pos, 1.0, 0.3),
    "motion_body_ori": kernel(tracking.motion_body_ori, 1.0, 0.4),
    "motion_body_lin_vel": kernel(tracking.motion_body_lin_vel, 1.0, 1.0),
    "motion_body_ang_vel": kernel(tracking.motion_body_ang_vel, 1.0, 3.14),
    "action_rate_l2": RewardTermCfg(mdp.action_rate_l2, weight=-0.1),
    "joint_limit": RewardTermCfg(mdp.joint_pos_limits, weight=-10.0),
    "self_collisions": RewardTermCfg(mdp.contact_count, weight=-10.0, params={"sensor": "self_collision"}),
  }


def _terminations() -> dict[str, TerminationTermCfg | None]:
  def lost(func: Callable[..., Any], threshold: float, **params: object) -> TerminationTermCfg:
    return TerminationTermCfg(func, params={"command": "motion", "threshold": threshold, **params})

  return {
    "time_out": TerminationTermCfg(mdp.time_out, time_out=True),
    "motion_end": TerminationTermCfg(tracking.motion_end, time_out=True, params={"command": "motion"}),
    "anchor_pos": lost(tracking.bad_anchor_height, MAX_HEIGHT_ERROR),
    "anchor_ori": lost(tracking.bad_anchor_ori, MAX_TILT_ERROR),
    "ee_body_pos": lost(tracking.bad_body_height, MAX_HEIGHT_ERROR, bodies=END_EFFECTORS),
  }


def _events() -> dict[str, EventTermCfg | None]:
  com = body_com_offset(ANCHOR, {"x": (-0.025, 0.025), "y": (-0.05, 0.05), "z": (-0.05, 0.05)})
  friction = geom_friction(".*_foot[1-7]_collision", (0.3, 1.2), axes=(0,), shared=True)
  return {
    "push_robot": EventTermCfg(
      mdp.push_by_setting_velocity,
      mode="interval",
      interval_range_s=PUSH_INTERVAL,
      params={"velocity_range": dict(VELOCITY)},
    ),
    "base_com": mdp.randomize_at_startup(com),
    "encoder_bias": mdp.randomize_at_startup(encoder_bias(".*", (-0.01, 0.01))),
    "foot_friction": mdp.randomize_at_startup(friction),
  }


def play(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  """Return the play config: whole clips without pushes, perturbations or noise."""
  cfg.episode_length_s = 1e9
  actor, motion = cfg.observations["actor"], cfg.commands["motion"]
  if actor is not None:
    actor.corrupt = False
  if isinstance(motion, tracking.MotionCommandCfg):
    motion.sampling = "start"
    motion.pose_range, motion.velocity_range, motion.joint_position_range = {}, {}, (0.0, 0.0)
  cfg.events["push_robot"] = None
  return cfg


def evaluator() -> TrackingEvaluation:
  """Return the evaluator of both tasks."""
  return TrackingEvaluation(end_effectors=END_EFFECTORS)


def agent() -> RslRlOnPolicyRunnerCfg:
  """Return the learner of both tasks."""
  actor = RslRlModelCfg(
    hidden_dims=(512, 256, 128),
    obs_normalization=True,
    distribution_cfg={"class_name": "GaussianDistribution", "init_std": 1.0, "std_type": "scalar"},
  )
  critic = RslRlModelCfg(hidden_dims=(512, 256, 128), obs_normalization=True)
  return RslRlOnPolicyRunnerCfg(
    experiment_name="g1_tracking",
    actor=actor,
    critic=critic,
    algorithm=RslRlPpoAlgorithmCfg(entropy_coef=0.005),
    num_steps_per_env=24,
    max_iterations=30_000,
    save_interval=500,
  )
