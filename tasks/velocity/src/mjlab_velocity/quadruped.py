"""Velocity tasks of the Unitree Go1 and Go2. Bodies and geoms of both have the same names."""

from dataclasses import replace
from functools import partial

from mjlab_dr import geom_friction
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import RewardTermCfg, TerminationTermCfg
from mjlab_robots import GO1_ACTION_SCALE, GO2_ACTION_SCALE, go1, go2
from mjlab_sensors import ContactMatch, RingPatternCfg

from mjlab_velocity import mdp as velocity
from mjlab_velocity.legged import LeggedRobot, flat_env, physics
from mjlab_velocity.rough import ground_contact, rough_env, self_collision
from mjlab_velocity.tasks import RobotTasks

FEET = ("FR", "FL", "RR", "RL")
_FOOT_GEOMS = ".*_foot_collision"

# Allowed deviation of joints from the default pose [rad]
STD_STANDING = {".*_(hip|thigh)_joint": 0.05, ".*_calf_joint": 0.1}
STD_MOVING = {".*_(hip|thigh)_joint": 0.3, ".*_calf_joint": 0.6}


# Feet begin 1 to 5 cm above the ground: the default pose of the Go1 reaches 16.5 mm below z = 0, the Go2's 18.4 mm.
_GO1 = LeggedRobot(
  entity=go1,
  action_scale=GO1_ACTION_SCALE,
  torso="trunk",
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
  start_height=(0.0265, 0.0665),
  std_standing=STD_STANDING,
  std_walking=STD_MOVING,
  std_running=STD_MOVING,
  sim=physics(cone="elliptic", impratio=10.0, ccd_iterations=50),
)
_GO2 = replace(_GO1, entity=go2, action_scale=GO2_ACTION_SCALE, torso="base", start_height=(0.0284, 0.0684))


def _rough_env(robot: LeggedRobot, *, trunk_geoms: str) -> ManagerBasedRlEnvCfg:
  """Return the training environment on rough ground; geoms that match `trunk_geoms` must not touch it."""
  cfg = rough_env(robot, scan_body=robot.torso)
  touched = {"thigh": ".*_thigh_collision.*", "shank": ".*_calf_collision.*", "trunk": trunk_geoms}
  for part, geoms in touched.items():
    sensor = ground_contact(ContactMatch(mode="geom", pattern=geoms, entity="robot"))
    cfg.scene.sensors[f"{part}_ground_touch"] = sensor
  cfg.scene.sensors["self_collision"] = self_collision(robot.torso)
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


GO1 = RobotTasks(
  experiment_name="go1_velocity",
  max_iterations=10_000,
  flat_env=partial(flat_env, _GO1),
  rough_env=partial(_rough_env, _GO1, trunk_geoms="(trunk|head)_collision"),
)
GO2 = RobotTasks(
  experiment_name="go2_velocity",
  max_iterations=10_000,
  flat_env=partial(flat_env, _GO2),
  rough_env=partial(_rough_env, _GO2, trunk_geoms="(trunk|head|lidar)_collision"),
)
go1_flat, go1_flat_blind, go1_flat_env = GO1.flat, GO1.flat_blind, GO1.flat_env
go1_rough, go1_rough_blind, go1_rough_env = GO1.rough, GO1.rough_blind, GO1.rough_env
go2_flat, go2_flat_blind, go2_flat_env = GO2.flat, GO2.flat_blind, GO2.flat_env
go2_rough, go2_rough_blind, go2_rough_env = GO2.rough, GO2.rough_blind, GO2.rough_env
