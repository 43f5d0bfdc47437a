"""Velocity tasks of four-legged robots whose bodies and geoms are named as those of the Go1."""

from collections.abc import Callable

from mjlab_dr import geom_friction
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import RewardTermCfg, TerminationTermCfg
from mjlab_scene import EntityCfg
from mjlab_sensors import ContactMatch, ContactSensorCfg, RingPatternCfg
from mjlab_sim import SimulationCfg

from mjlab_velocity import mdp as velocity
from mjlab_velocity.legged import PHYSICS_DT, LeggedRobot
from mjlab_velocity.rough import ground_contact, rough_env, self_collision

FEET = ("FR", "FL", "RR", "RL")
_FOOT_GEOMS = ".*_foot_collision"

# Allowed deviation of joints from the default pose [rad]
STD_STANDING = {".*_(hip|thigh)_joint": 0.05, ".*_calf_joint": 0.1}
STD_MOVING = {".*_(hip|thigh)_joint": 0.3, ".*_calf_joint": 0.6}


def quadruped(
  entity: Callable[[], EntityCfg], action_scale: dict[str, float], torso: str, start_height: tuple[float, float]
) -> LeggedRobot:
  """Return what the velocity tasks know of a robot.

  Args:
    entity: Function that returns the entity.
    action_scale: Scale of the actions by joint pattern [rad].
    torso: Body of the torso.
    start_height: Range of the height above the default pose at which episodes begin [m].
  """
  return LeggedRobot(
    entity=entity,
    action_scale=action_scale,
    torso=torso,
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
    start_height=start_height,
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
    ),
  )


def quadruped_rough_env(robot: LeggedRobot, trunk_geoms: str) -> ManagerBasedRlEnvCfg:
  """Return the training environment on rough ground; `trunk_geoms` is the pattern of what must not touch it."""
  cfg = rough_env(robot, scan_body=robot.torso)
  cfg.scene.sensors |= {
    "self_collision": self_collision(robot.torso),
    "thigh_ground_touch": _touch(".*_thigh_collision.*"),
    "shank_ground_touch": _touch(".*_calf_collision.*"),
    "trunk_ground_touch": _touch(trunk_geoms),
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
