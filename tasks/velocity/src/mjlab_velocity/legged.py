"""Velocity task of a legged robot on a plane, and the learner of all velocity tasks."""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from mjlab_dr import FieldRandomizer, body_com_offset, encoder_bias
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
from mjlab_rl import RslRlOnPolicyRunnerCfg, control_agent
from mjlab_scene import EntityCfg, SceneCfg
from mjlab_sensors import ContactMatch, ContactSensorCfg, FrameMatch, RingPatternCfg, SensorCfg, TerrainHeightSensorCfg
from mjlab_sim import SimulationCfg
from mjlab_terrain import PlaneCfg

from mjlab_velocity import mdp as velocity

FRICTION_AXES = ("slide", "spin", "roll")
"""Names of the axes of friction in MuJoCo's order."""

# Timing
PHYSICS_DT = 0.005  # s
DECIMATION = 4
EPISODE_LENGTH = 20.0  # s

# Commands: speeds in m/s and rad/s; stages begin at environment steps, 24 of which make an iteration.
COMMAND_STAGES = [
  velocity.VelocityStage(step=0, lin_vel_x=(-1.0, 1.0), ang_vel_z=(-0.5, 0.5)),
  velocity.VelocityStage(step=5_000 * 24, lin_vel_x=(-1.5, 2.0), ang_vel_z=(-0.7, 0.7)),
  velocity.VelocityStage(step=10_000 * 24, lin_vel_x=(-2.0, 3.0)),
]

# Gait
MOVING = 0.05  # m/s, commanded speed above which gait rewards count
SWING_HEIGHT = 0.1  # m, centre of the foot above the ground
MAX_TILT = math.radians(70.0)

# Pushes: added to the root's velocity every 1 to 3 s [m/s, rad/s]
PUSH = {
  "x": (-0.5, 0.5),
  "y": (-0.5, 0.5),
  "z": (-0.4, 0.4),
  "roll": (-0.52, 0.52),
  "pitch": (-0.52, 0.52),
  "yaw": (-0.78, 0.78),
}

# Largest noise of the actor's observations
NOISE = {"base_lin_vel": 0.5, "base_ang_vel": 0.2, "projected_gravity": 0.05, "joint_pos": 0.01, "joint_vel": 1.5}


def physics(**options: Any) -> SimulationCfg:
  """Return the time step and the solver of all velocity tasks, with other options of a robot."""
  return SimulationCfg(timestep=PHYSICS_DT, iterations=10, ls_iterations=20, **options)


@dataclass(kw_only=True)
class LeggedRobot:
  """Numbers of a robot that the velocity tasks need.

  It has the sensors `imu_lin_vel`, `imu_ang_vel` (of the base) and `root_angmom`.
  """

  entity: Callable[[], EntityCfg]
  action_scale: dict[str, float]
  """Shift of the target per unit of action by joint pattern [rad]."""
  torso: str
  """Body with a reward for its upright orientation and a randomised centre of mass."""
  feet: tuple[str, ...]
  """Sites of the feet."""
  foot_contact: ContactMatch
  """Bodies or geoms that touch the ground, one for each of `feet` in their order."""
  foot_rays: RingPatternCfg = field(default_factory=lambda: RingPatternCfg(radius=0.03, num_samples=4))
  """Pattern of the rays that find the ground under a foot."""
  foot_friction: tuple[FieldRandomizer, ...] = ()
  """Randomisers of friction: sliding, then torsional, then rolling."""
  start_height: tuple[float, float] = (0.01, 0.05)
  """Range of the root's height above its default at the start of an episode [m]."""
  std_standing: dict[str, float] = field(default_factory=lambda: {".*": 0.05})
  """Allowed deviation of joints from the default pose while standing, by joint pattern [rad]."""
  std_walking: dict[str, float] = field(default_factory=lambda: {".*": 0.3})
  """Allowed deviation while walking, likewise."""
  std_running: dict[str, float] = field(default_factory=lambda: {".*": 0.5})
  """Allowed deviation while running, likewise."""
  weights: dict[str, float] = field(default_factory=dict)
  """Reward weights that differ from the family's."""
  sim: SimulationCfg = field(default_factory=physics)
  """Solver and buffers, made by `physics`."""


def flat_env(robot: LeggedRobot) -> ManagerBasedRlEnvCfg:
  """Return the config of a robot that follows velocity commands on a plane; it shares no part with another config."""
  cfg = ManagerBasedRlEnvCfg(
    decimation=DECIMATION,
    episode_length_s=EPISODE_LENGTH,
    sim=robot.sim,
    scene=SceneCfg(terrain=PlaneCfg(), entities={"robot": robot.entity()}, sensors=_sensors(robot), extent=2.0),
    actions={"joint_pos": mdp.JointPositionActionCfg(entity="robot", actuators=".*", scale=robot.action_scale)},
    commands={"twist": velocity.UniformVelocityCommandCfg(ranges=velocity.VelocityRanges())},
    observations={"actor": _actor(), "critic": _critic()},
    rewards=_rewards(robot),
    terminations={
      "time_out": TerminationTermCfg(mdp.time_out, time_out=True),
      "fell_over": TerminationTermCfg(mdp.bad_orientation, params={"limit_angle": MAX_TILT}),
    },
    events=_events(robot),
    curriculum={
      "command_vel": CurriculumTermCfg(velocity.commands_vel, params={"command": "twist", "stages": COMMAND_STAGES})
    },
    metrics={"mean_action_acc": MetricsTermCfg(mdp.mean_action_acc)},
  )
  # A change of the copy changes no constant of a module.
  return copy.deepcopy(cfg)


def _sensors(robot: LeggedRobot) -> dict[str, SensorCfg]:
  return {
    "feet_ground_contact": ContactSensorCfg(
      primary=robot.foot_contact,
      secondary=ContactMatch(mode="body", pattern="terrain"),
      fields=("found", "force"),
      reduce="netforce",
      track_air_time=True,
    ),
    "foot_height_scan": TerrainHeightSensorCfg(
      frames=FrameMatch(type="site", pattern=robot.feet, entity="robot", preserve_order=True),
      pattern=robot.foot_rays,
      max_distance=1.0,
    ),
  }


def _actor() -> ObservationGroupCfg:
  terms: dict[str, ObservationTermCfg] = {
    "base_lin_vel": ObservationTermCfg(mdp.builtin_sensor, params={"sensor": "robot/imu_lin_vel"}),
    "base_ang_vel": ObservationTermCfg(mdp.builtin_sensor, params={"sensor": "robot/imu_ang_vel"}),
    "projected_gravity": ObservationTermCfg(mdp.projected_gravity),
    "joint_pos": ObservationTermCfg(mdp.joint_pos_rel, params={"biased": True}),
    "joint_vel": ObservationTermCfg(mdp.joint_vel_rel),
    "actions": ObservationTermCfg(mdp.last_action),
    "command": ObservationTermCfg(mdp.generated_commands, params={"command": "twist"}),
  }
  for name, most in NOISE.items():
    terms[name].noise = UniformNoiseCfg(n_min=-most, n_max=most)
  # Rough ground has a scan.
  return ObservationGroupCfg(corrupt=True, terms={**terms, "height_scan": None})


def _critic() -> ObservationGroupCfg:
  group = _actor()
  group.corrupt = False
  group.terms |= {
    "joint_pos": ObservationTermCfg(mdp.joint_pos_rel),
    "foot_height": ObservationTermCfg(velocity.foot_height, params={"sensor": "foot_height_scan"}),
    "foot_air_time": ObservationTermCfg(velocity.foot_air_time, params={"sensor": "feet_ground_contact"}),
    "foot_contact": ObservationTermCfg(velocity.foot_contact, params={"sensor": "feet_ground_contact"}),
    "foot_contact_forces": ObservationTermCfg(velocity.foot_contact_forces, params={"sensor": "feet_ground_contact"}),
  }
  return group


def _rewards(robot: LeggedRobot) -> dict[str, RewardTermCfg | None]:
  gait = {"command": "twist", "threshold": MOVING}
  feet = SceneEntityCfg("robot", site_names=robot.feet, preserve_order=True)
  torso = SceneEntityCfg("robot", body_names=robot.torso)
  contact, heights = "feet_ground_contact", "foot_height_scan"
  rewards = {
    "track_linear_velocity": RewardTermCfg(
      velocity.track_linear_velocity, weight=2.0, params={"command": "twist", "std": math.sqrt(0.25)}
    ),
    "track_angular_velocity": RewardTermCfg(
      velocity.track_angular_velocity, weight=2.0, params={"command": "twist", "std": math.sqrt(0.5)}
    ),
    "upright": RewardTermCfg(velocity.upright, weight=1.0, params={"std": math.sqrt(0.2), "asset": torso}),
    "pose": RewardTermCfg(
      velocity.variable_posture,
      weight=1.0,
      params={
        "command": "twist",
        "std_standing": robot.std_standing,
        "std_walking": robot.std_walking,
        "std_running": dict(robot.std_running),
        "walking_threshold": 0.05,
        "running_threshold": 1.5,
      },
    ),
    "body_ang_vel": RewardTermCfg(velocity.body_ang_vel_xy_l2, weight=0.0, params={"asset": torso}),
    "angular_momentum": RewardTermCfg(velocity.angular_momentum_l2, weight=0.0, params={"sensor": "robot/root_angmom"}),
    "dof_pos_limits": RewardTermCfg(mdp.joint_pos_limits, weight=-1.0),
    "action_rate_l2": RewardTermCfg(mdp.action_rate_l2, weight=-0.1),
    "air_time": RewardTermCfg(
      velocity.feet_air_time, weight=0.0, params={"sensor": contact, "command": "twist", "threshold": 0.5}
    ),
    "foot_clearance": RewardTermCfg(
      velocity.feet_clearance, weight=-2.0, params={**gait, "heights": heights, "target": SWING_HEIGHT, "feet": feet}
    ),
    "foot_swing_height": RewardTermCfg(
      velocity.feet_swing_height,
      weight=-0.25,
      params={**gait, "sensor": contact, "heights": heights, "target": SWING_HEIGHT},
    ),
    "foot_slip": RewardTermCfg(velocity.feet_slip, weight=-0.1, params={**gait, "sensor": contact, "feet": feet}),
    "soft_landing": RewardTermCfg(velocity.soft_landing, weight=-1e-5, params={**gait, "sensor": contact}),
  }
  for name, weight in robot.weights.items():
    rewards[name].weight = weight
  # Terms share no part, so that a change of one changes no other.
  return {name: copy.deepcopy(term) for name, term in rewards.items()}


def _events(robot: LeggedRobot) -> dict[str, EventTermCfg | None]:
  start = {"x": (-0.5, 0.5), "y": (-0.5, 0.5), "z": robot.start_height, "yaw": (-math.pi, math.pi)}
  com = body_com_offset(robot.torso, {"x": (-0.025, 0.025), "y": (-0.025, 0.025), "z": (-0.03, 0.03)})
  # Each world draws one value for all its feet.
  friction = zip(FRICTION_AXES, robot.foot_friction, strict=False)
  return {
    "reset_base": EventTermCfg(mdp.reset_root_state_uniform, mode="reset", params={"pose_range": start}),
    "reset_robot_joints": EventTermCfg(
      mdp.reset_joints_by_offset,
      mode="reset",
      params={"position_range": (0.0, 0.0), "velocity_range": (0.0, 0.0)},
    ),
    "push_robot": EventTermCfg(
      mdp.push_by_setting_velocity, mode="interval", interval_range_s=(1.0, 3.0), params={"velocity_range": PUSH}
    ),
    **{f"foot_friction_{axis}": mdp.randomize_at_startup(randomizer) for axis, randomizer in friction},
    "encoder_bias": mdp.randomize_at_startup(encoder_bias(".*", (-0.015, 0.015))),
    "base_com": mdp.randomize_at_startup(com),
  }


def play_flat(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  """Turn a training config into one for watching: endless episodes, no observation noise, no pushes, no curriculum."""
  cfg.episode_length_s = 1e9
  actor = cfg.observations["actor"]
  if actor is not None:
    actor.corrupt = False
  cfg.events["push_robot"] = None
  cfg.curriculum = {}
  return cfg


def agent(experiment_name: str, max_iterations: int) -> RslRlOnPolicyRunnerCfg:
  """Return the learner of all velocity tasks."""
  return control_agent(experiment_name, max_iterations, entropy_coef=0.01)
