"""The Go1 walks: observations, rewards, events and learner of the flat task."""

import math

from mjlab_dr import body_com_offset, encoder_bias, geom_friction
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
from mjlab_rl import RslRlModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg, TaskCfg
from mjlab_robots import GO1_ACTION_SCALE, go1
from mjlab_scene import SceneCfg
from mjlab_sensors import ContactMatch, ContactSensorCfg, FrameMatch, RingPatternCfg, TerrainHeightSensorCfg
from mjlab_sim import SimulationCfg
from mjlab_terrain import PlaneCfg

from mjlab_velocity import mdp as velocity

FEET = ("FR", "FL", "RR", "RL")

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

# Posture: how far joints may stray from the default pose [rad]
STD_STANDING = {".*_(hip|thigh)_joint": 0.05, ".*_calf_joint": 0.1}
STD_MOVING = {".*_(hip|thigh)_joint": 0.3, ".*_calf_joint": 0.6}

# Gait
MOVING = 0.05  # commanded speed above which the gait is judged
SWING_HEIGHT = 0.1  # m, centre of the foot above the ground
MAX_TILT = math.radians(70.0)

# Start: the default pose reaches 16.5 mm below its root's origin, so feet begin 1 to 5 cm above the ground.
START = {"x": (-0.5, 0.5), "y": (-0.5, 0.5), "z": (0.0265, 0.0665), "yaw": (-math.pi, math.pi)}

# Pushes: added to the root's velocity every 1 to 3 s [m/s, rad/s]
PUSH = {
  "x": (-0.5, 0.5),
  "y": (-0.5, 0.5),
  "z": (-0.4, 0.4),
  "roll": (-0.52, 0.52),
  "pitch": (-0.52, 0.52),
  "yaw": (-0.78, 0.78),
}

# Noise of what the policy sees
NOISE_LIN_VEL = UniformNoiseCfg(n_min=-0.5, n_max=0.5)
NOISE_ANG_VEL = UniformNoiseCfg(n_min=-0.2, n_max=0.2)
NOISE_GRAVITY = UniformNoiseCfg(n_min=-0.05, n_max=0.05)
NOISE_JOINT_POS = UniformNoiseCfg(n_min=-0.01, n_max=0.01)
NOISE_JOINT_VEL = UniformNoiseCfg(n_min=-1.5, n_max=1.5)


def go1_flat() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Go1 follows velocity commands on a plane."""
  return TaskCfg(env=go1_flat_env(), play=play, agent=go1_agent())


def go1_flat_env() -> ManagerBasedRlEnvCfg:
  """The environment of training."""
  return ManagerBasedRlEnvCfg(
    decimation=DECIMATION,
    episode_length_s=EPISODE_LENGTH,
    sim=SimulationCfg(
      timestep=PHYSICS_DT,
      cone="elliptic",
      impratio=10.0,
      iterations=10,
      ls_iterations=20,
      ccd_iterations=50,
      # Random play wants up to 6 contacts and 36 rows a world; what would not fit is counted and reported.
      nconmax=16,
      njmax=128,
    ),
    scene=SceneCfg(
      terrain=PlaneCfg(),
      entities={"robot": go1()},
      sensors={
        "feet_ground_contact": ContactSensorCfg(
          primary=ContactMatch(
            mode="geom", pattern=tuple(f"{foot}_foot_collision" for foot in FEET), entity="robot", preserve_order=True
          ),
          secondary=ContactMatch(mode="body", pattern="terrain"),
          fields=("found", "force"),
          reduce="netforce",
          track_air_time=True,
        ),
        "foot_height_scan": TerrainHeightSensorCfg(
          frames=FrameMatch(type="site", pattern=FEET, entity="robot", preserve_order=True),
          pattern=RingPatternCfg(radius=0.04, num_samples=4),
          max_distance=1.0,
        ),
      },
      extent=2.0,
    ),
    actions={"joint_pos": mdp.JointPositionActionCfg(entity="robot", actuators=".*", scale=GO1_ACTION_SCALE)},
    commands={"twist": velocity.UniformVelocityCommandCfg(ranges=velocity.VelocityRanges())},
    observations={"actor": _actor(), "critic": _critic()},
    rewards=_rewards(),
    terminations={
      "time_out": TerminationTermCfg(mdp.time_out, time_out=True),
      "fell_over": TerminationTermCfg(mdp.bad_orientation, params={"limit_angle": MAX_TILT}),
    },
    events=_events(),
    curriculum={
      "command_vel": CurriculumTermCfg(velocity.commands_vel, params={"command": "twist", "stages": COMMAND_STAGES})
    },
    metrics={"mean_action_acc": MetricsTermCfg(mdp.mean_action_acc)},
  )


def _actor() -> ObservationGroupCfg:
  def term(func, noise=None, **params) -> ObservationTermCfg:
    return ObservationTermCfg(func, noise=noise, params=params)

  return ObservationGroupCfg(
    corrupt=True,
    terms={
      "base_lin_vel": term(mdp.builtin_sensor, NOISE_LIN_VEL, sensor="robot/imu_lin_vel"),
      "base_ang_vel": term(mdp.builtin_sensor, NOISE_ANG_VEL, sensor="robot/imu_ang_vel"),
      "projected_gravity": term(mdp.projected_gravity, NOISE_GRAVITY),
      "joint_pos": term(mdp.joint_pos_rel, NOISE_JOINT_POS, biased=True),
      "joint_vel": term(mdp.joint_vel_rel, NOISE_JOINT_VEL),
      "actions": term(mdp.last_action),
      "command": term(mdp.generated_commands, command="twist"),
    },
  )


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


def _rewards() -> dict[str, RewardTermCfg | None]:
  gait = {"command": "twist", "threshold": MOVING}
  feet = SceneEntityCfg("robot", site_names=FEET, preserve_order=True)
  contact, heights = "feet_ground_contact", "foot_height_scan"
  return {
    "track_linear_velocity": RewardTermCfg(
      velocity.track_linear_velocity, weight=2.0, params={"command": "twist", "std": math.sqrt(0.25)}
    ),
    "track_angular_velocity": RewardTermCfg(
      velocity.track_angular_velocity, weight=2.0, params={"command": "twist", "std": math.sqrt(0.5)}
    ),
    "upright": RewardTermCfg(velocity.upright, weight=1.0, params={"std": math.sqrt(0.2)}),
    "pose": RewardTermCfg(
      velocity.variable_posture,
      weight=1.0,
      params={
        "command": "twist",
        "std_standing": STD_STANDING,
        "std_walking": STD_MOVING,
        "std_running": STD_MOVING,
        "walking_threshold": 0.05,
        "running_threshold": 1.5,
      },
    ),
    "body_ang_vel": RewardTermCfg(
      velocity.body_ang_vel_xy_l2, weight=0.0, params={"asset": SceneEntityCfg("robot", body_names="trunk")}
    ),
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


def _events() -> dict[str, EventTermCfg | None]:
  def startup(randomizer) -> EventTermCfg:
    return EventTermCfg(mdp.randomize, mode="startup", params={"randomizer": randomizer})

  foot = ".*_foot_collision"
  return {
    "reset_base": EventTermCfg(mdp.reset_root_state_uniform, mode="reset", params={"pose_range": START}),
    "reset_robot_joints": EventTermCfg(
      mdp.reset_joints_by_offset,
      mode="reset",
      params={"position_range": (0.0, 0.0), "velocity_range": (0.0, 0.0)},
    ),
    "push_robot": EventTermCfg(
      mdp.push_by_setting_velocity, mode="interval", interval_range_s=(1.0, 3.0), params={"velocity_range": PUSH}
    ),
    # Each world draws one value for all its feet.
    "foot_friction_slide": startup(geom_friction(foot, (0.3, 1.5), axes=(0,), shared=True)),
    "foot_friction_spin": startup(
      geom_friction(foot, (1e-4, 2e-2), axes=(1,), distribution="log_uniform", shared=True)
    ),
    "foot_friction_roll": startup(
      geom_friction(foot, (1e-5, 5e-3), axes=(2,), distribution="log_uniform", shared=True)
    ),
    "encoder_bias": startup(encoder_bias(".*", (-0.015, 0.015))),
    "base_com": startup(body_com_offset("trunk", {"x": (-0.025, 0.025), "y": (-0.025, 0.025), "z": (-0.03, 0.03)})),
  }


def play(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  """For watching: episodes without end, what the policy sees without noise, nobody pushes, faster commands."""
  cfg.episode_length_s = 1e9
  actor = cfg.observations["actor"]
  if actor is not None:
    actor.corrupt = False
  cfg.events["push_robot"] = None
  cfg.curriculum = {}
  twist = cfg.commands["twist"]
  if isinstance(twist, velocity.UniformVelocityCommandCfg):
    twist.ranges = velocity.VelocityRanges(lin_vel_x=(-1.5, 2.0), ang_vel_z=(-0.7, 0.7))
  return cfg


def go1_agent() -> RslRlOnPolicyRunnerCfg:
  """The learner."""
  actor = RslRlModelCfg(
    hidden_dims=(512, 256, 128),
    obs_normalization=True,
    distribution_cfg={"class_name": "GaussianDistribution", "init_std": 1.0, "std_type": "scalar"},
  )
  critic = RslRlModelCfg(hidden_dims=(512, 256, 128), obs_normalization=True)
  return RslRlOnPolicyRunnerCfg(
    experiment_name="go1_velocity",
    actor=actor,
    critic=critic,
    algorithm=RslRlPpoAlgorithmCfg(entropy_coef=0.01),
    num_steps_per_env=24,
    max_iterations=10_000,
    save_interval=50,
  )
