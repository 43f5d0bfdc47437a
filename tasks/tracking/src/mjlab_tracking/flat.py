"""Tracking task of a humanoid on a plane, and the learner of all tracking tasks."""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from mjlab_dr import FieldRandomizer, body_com_offset, encoder_bias
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
from mjlab_rl import RslRlOnPolicyRunnerCfg, control_agent
from mjlab_scene import EntityCfg, SceneCfg
from mjlab_sensors import ContactMatch, ContactSensorCfg
from mjlab_sim import SimulationCfg
from mjlab_terrain import PlaneCfg

from mjlab_tracking import mdp as tracking

T = TypeVar("T")

# Timing
PHYSICS_DT = 0.005  # s
DECIMATION = 4
EPISODE_LENGTH = 10.0  # s

# Perturbation of starts [m, rad, m/s, rad/s]; pushes draw from the same velocities.
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

# Errors that end the episode
MAX_HEIGHT_ERROR = 0.25  # m, of the anchor, hands and feet
MAX_TILT_ERROR = 0.8  # difference of gravity's z in both anchors

OF_MOTION = {"command": "motion"}

# Noise of observations
NOISE_ANCHOR_POS = UniformNoiseCfg(n_min=-0.25, n_max=0.25)
NOISE_ANCHOR_ORI = UniformNoiseCfg(n_min=-0.05, n_max=0.05)
NOISE_LIN_VEL = UniformNoiseCfg(n_min=-0.5, n_max=0.5)
NOISE_ANG_VEL = UniformNoiseCfg(n_min=-0.2, n_max=0.2)
NOISE_JOINT_POS = UniformNoiseCfg(n_min=-0.01, n_max=0.01)
NOISE_JOINT_VEL = UniformNoiseCfg(n_min=-0.5, n_max=0.5)


@dataclass(kw_only=True)
class TrackedRobot:
  """Numbers of a robot that the tracking task needs. It has the sensors `imu_lin_vel` and `imu_ang_vel`."""

  entity: Callable[[], EntityCfg]
  action_scale: dict[str, float]
  """Shift of the target per unit of action by joint pattern [rad]."""
  anchor: str
  """Body at which the reference is laid over the robot, and whose centre of mass is randomised."""
  bodies: tuple[str, ...]
  """Bodies that follow the clip; clips hold their poses."""
  end_effectors: tuple[str, ...]
  """Bodies whose height errors end the episode."""
  root: str
  """Root body; contacts between bodies below it are penalised."""
  foot_friction: FieldRandomizer | None = None
  """Randomiser of the friction of feet."""
  sim: SimulationCfg
  """Solver and buffers; its time step is that of the task, `PHYSICS_DT`."""


def flat_env(robot: TrackedRobot, motion: str) -> ManagerBasedRlEnvCfg:
  """Return the config of a robot that follows clips on a plane; each call returns an independent copy.

  Args:
    robot: The robot.
    motion: Name of a clip that ships, a motion file, or a folder of them.
  """
  cfg = ManagerBasedRlEnvCfg(
    decimation=DECIMATION,
    episode_length_s=EPISODE_LENGTH,
    sim=robot.sim,
    scene=SceneCfg(
      terrain=PlaneCfg(),
      entities={"robot": robot.entity()},
      sensors={"self_collision": _self_collision(robot.root)},
      extent=2.0,
    ),
    actions={"joint_pos": mdp.JointPositionActionCfg(entity="robot", actuators=".*", scale=dict(robot.action_scale))},
    commands={
      "motion": tracking.MotionCommandCfg(
        motion=motion,
        anchor_body=robot.anchor,
        bodies=robot.bodies,
        pose_range=dict(POSE),
        velocity_range=dict(VELOCITY),
        joint_position_range=JOINT_POSITION,
      )
    },
    observations={"actor": _actor(), "critic": _critic()},
    rewards=_rewards(),
    terminations=_terminations(robot),
    events=_events(robot),
    metrics={
      f"error_{quantity}": MetricsTermCfg(tracking.motion_error, params={"command": "motion", "quantity": quantity})
      for quantity in tracking.QUANTITIES
    },
  )
  # Terms share no part with constants, arguments or one another.
  for group in cfg.observations.values():
    if group is not None:
      group.terms = _apart(group.terms)
  cfg.events = _apart(cfg.events)
  return cfg


def _apart(terms: dict[str, T]) -> dict[str, T]:
  return {name: copy.deepcopy(term) for name, term in terms.items()}


def _self_collision(root: str) -> ContactSensorCfg:
  """Return the sensor of the strongest self-contact in each substep."""
  robot = ContactMatch(mode="subtree", pattern=root, entity="robot")
  return ContactSensorCfg(
    primary=robot,
    secondary=copy.deepcopy(robot),
    fields=("found", "force"),
    reduce="maxforce",
    history_length="decimation",
  )


def _observations(
  joint_pos: ObservationTermCfg, bodies: dict[str, ObservationTermCfg], *, corrupt: bool
) -> ObservationGroupCfg:
  return ObservationGroupCfg(
    corrupt=corrupt,
    terms={
      "command": ObservationTermCfg(mdp.generated_commands, params=OF_MOTION),
      "motion_anchor_pos_b": ObservationTermCfg(tracking.motion_anchor_pos_b, noise=NOISE_ANCHOR_POS, params=OF_MOTION),
      "motion_anchor_ori_b": ObservationTermCfg(tracking.motion_anchor_ori_b, noise=NOISE_ANCHOR_ORI, params=OF_MOTION),
      **bodies,
      "base_lin_vel": ObservationTermCfg(
        mdp.builtin_sensor, noise=NOISE_LIN_VEL, params={"sensor": "robot/imu_lin_vel"}
      ),
      "base_ang_vel": ObservationTermCfg(
        mdp.builtin_sensor, noise=NOISE_ANG_VEL, params={"sensor": "robot/imu_ang_vel"}
      ),
      "joint_pos": joint_pos,
      "joint_vel": ObservationTermCfg(mdp.joint_vel_rel, noise=NOISE_JOINT_VEL),
      "actions": ObservationTermCfg(mdp.last_action),
    },
  )


def _actor() -> ObservationGroupCfg:
  biased = ObservationTermCfg(mdp.joint_pos_rel, noise=NOISE_JOINT_POS, params={"biased": True})
  return _observations(biased, {}, corrupt=True)


def _critic() -> ObservationGroupCfg:
  bodies = {
    "body_pos": ObservationTermCfg(tracking.robot_body_pos_b, params=OF_MOTION),
    "body_ori": ObservationTermCfg(tracking.robot_body_ori_b, params=OF_MOTION),
  }
  return _observations(ObservationTermCfg(mdp.joint_pos_rel), bodies, corrupt=False)


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


def _terminations(robot: TrackedRobot) -> dict[str, TerminationTermCfg | None]:
  def lost(func: Callable[..., Any], threshold: float, **params: object) -> TerminationTermCfg:
    return TerminationTermCfg(func, params={"command": "motion", "threshold": threshold, **params})

  return {
    "time_out": TerminationTermCfg(mdp.time_out, time_out=True),
    "motion_end": TerminationTermCfg(tracking.motion_end, time_out=True, params={"command": "motion"}),
    "anchor_pos": lost(tracking.bad_anchor_height, MAX_HEIGHT_ERROR),
    "anchor_ori": lost(tracking.bad_anchor_ori, MAX_TILT_ERROR),
    "ee_body_pos": lost(tracking.bad_body_height, MAX_HEIGHT_ERROR, bodies=robot.end_effectors),
  }


def _events(robot: TrackedRobot) -> dict[str, EventTermCfg | None]:
  com = body_com_offset(robot.anchor, {"x": (-0.025, 0.025), "y": (-0.05, 0.05), "z": (-0.05, 0.05)})
  friction = {} if robot.foot_friction is None else {"foot_friction": mdp.randomize_at_startup(robot.foot_friction)}
  return {
    "push_robot": EventTermCfg(
      mdp.push_by_setting_velocity,
      mode="interval",
      interval_range_s=PUSH_INTERVAL,
      params={"velocity_range": dict(VELOCITY)},
    ),
    "base_com": mdp.randomize_at_startup(com),
    "encoder_bias": mdp.randomize_at_startup(encoder_bias(".*", (-0.01, 0.01))),
    **friction,
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


def agent(experiment_name: str, max_iterations: int) -> RslRlOnPolicyRunnerCfg:
  """Return the learner of all tracking tasks."""
  return control_agent(experiment_name, max_iterations, save_interval=500)
