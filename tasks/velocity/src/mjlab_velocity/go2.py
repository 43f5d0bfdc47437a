"""Velocity tasks of the Unitree Go2 on flat and rough ground."""

from mjlab_dr import geom_friction
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import RewardTermCfg, TerminationTermCfg
from mjlab_rl import TaskCfg
from mjlab_robots import GO2_ACTION_SCALE, go2
from mjlab_sensors import ContactMatch, ContactSensorCfg, RingPatternCfg
from mjlab_sim import SimulationCfg

from mjlab_velocity import mdp as velocity
from mjlab_velocity.evaluation import VelocityEvaluation
from mjlab_velocity.legged import PHYSICS_DT, LeggedRobot, agent, flat_env, play_flat
from mjlab_velocity.rough import ground_contact, play_rough, rough_env, self_collision
from mjlab_velocity.sim_to_real import blind

FEET = ("FR", "FL", "RR", "RL")
_FOOT_GEOMS = ".*_foot_collision"

# Allowed deviation of joints from the default pose [rad]
STD_STANDING = {".*_(hip|thigh)_joint": 0.05, ".*_calf_joint": 0.1}
STD_MOVING = {".*_(hip|thigh)_joint": 0.3, ".*_calf_joint": 0.6}


def _robot() -> LeggedRobot:
  return LeggedRobot(
    entity=go2,
    action_scale=GO2_ACTION_SCALE,
    torso="base",
    feet=FEET,
    foot_contact=ContactMatch(
      mode="geom", pattern=tuple(f"{foot}_foot_collision" for foot in FEET), entity="robot", preserve_order=True
    ),
    foot_rays=RingPatternCfg(radius=0.04, num_samples=4),
    foot_friction=(
      geom_friction(_FOOT_GEOMS, (0.3, 1.5), axes=(0,), shared=True),
      geom_friction(_FOOT_GEOMS, (1e-4, 2e-2), axes=(1,), distribution="log_uniform", shared=True),
      geom_friction(_FOOT_GEOMS, (1e-5, 5e-3), axes=(2,), distribution="log_uniform", shared=True),
    ),
    # The default pose reaches 18.4 mm below z = 0, so feet begin 1 to 5 cm above the ground.
    start_height=(0.0284, 0.0684),
    std_standing=STD_STANDING,
    std_walking=STD_MOVING,
    std_running=STD_MOVING,
    sim=SimulationCfg(
      timestep=PHYSICS_DT,
      cone="elliptic",
      impratio=10.0,
      iterations=10,
      ls_iterations=20,
      ccd_iterations=50,
      # Random actions need up to 6 contacts and 36 constraint rows in a world; an overflow is counted and reported.
      nconmax=16,
      njmax=128,
    ),
  )


def go2_flat() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of a Go2 that follows velocity commands on a plane."""
  return TaskCfg(
    env=go2_flat_env(), play=play_flat, agent=agent("go2_velocity", 10_000), evaluator=VelocityEvaluation()
  )


def go2_flat_blind() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the flat task for a Go2 that has only encoders and an IMU: `blind`."""
  return blind(go2_flat())


def go2_flat_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment on a plane."""
  return flat_env(_robot())


def go2_rough() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of a Go2 that follows velocity commands over stairs, slopes and rough ground."""
  return TaskCfg(
    env=go2_rough_env(), play=play_rough, agent=agent("go2_velocity", 10_000), evaluator=VelocityEvaluation()
  )


def go2_rough_blind() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the rough task for a Go2 that has only encoders and an IMU: `blind`."""
  return blind(go2_rough())


def go2_rough_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment on rough ground."""
  cfg = rough_env(_robot(), scan_body="base")
  cfg.sim.nconmax, cfg.sim.njmax = 35, 384
  cfg.scene.sensors |= {
    "self_collision": self_collision("base"),
    "thigh_ground_touch": _touch(".*_thigh_collision.*"),
    "shank_ground_touch": _touch(".*_calf_collision.*"),
    "trunk_ground_touch": _touch("(trunk|head|lidar)_collision"),
  }
  cfg.rewards["upright"] = RewardTermCfg(
    velocity.upright_on_terrain, weight=1.0, params={"std": 0.2**0.5, "sensor": "terrain_scan"}
  )
  for reward, sensor in (
    ("self_collisions", "self_collision"),
    ("shank_collision", "shank_ground_touch"),
    ("trunk_head_collision", "trunk_ground_touch"),
  ):
    cfg.rewards[reward] = RewardTermCfg(mdp.contact_count, weight=-0.1, params={"sensor": sensor})
  # A slipping leg does not end the episode; the weight of the robot on a thigh does.
  cfg.terminations["fell_over"] = None
  cfg.terminations["illegal_contact"] = TerminationTermCfg(mdp.illegal_contact, params={"sensor": "thigh_ground_touch"})
  return cfg


def _touch(geoms: str) -> ContactSensorCfg:
  return ground_contact(ContactMatch(mode="geom", pattern=geoms, entity="robot"))
