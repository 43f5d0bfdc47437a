"""Velocity tasks of the Unitree G1 on flat and rough ground."""

from mjlab_dr import geom_friction
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import RewardTermCfg
from mjlab_robots import G1_ACTION_SCALE, g1
from mjlab_sensors import ContactMatch, RingPatternCfg

from mjlab_velocity.legged import LeggedRobot, flat_env, physics
from mjlab_velocity.rough import rough_env, self_collision
from mjlab_velocity.symmetry import left_right
from mjlab_velocity.tasks import RobotTasks

# Allowed deviation of joints from the default pose [rad]
STD_WALKING = {
  ".*_hip_pitch_joint": 0.3,
  ".*_hip_(roll|yaw)_joint": 0.15,
  ".*_knee_joint": 0.35,
  ".*_ankle_pitch_joint": 0.25,
  ".*_ankle_roll_joint": 0.1,
  "waist_yaw_joint": 0.2,
  "waist_roll_joint": 0.08,
  "waist_pitch_joint": 0.1,
  ".*_shoulder_(pitch|roll)_joint": 0.15,
  ".*_shoulder_yaw_joint": 0.1,
  ".*_elbow_joint": 0.15,
  ".*_wrist_.*_joint": 0.3,
}
STD_RUNNING = {
  ".*_hip_pitch_joint": 0.5,
  ".*_hip_(roll|yaw)_joint": 0.2,
  ".*_knee_joint": 0.6,
  ".*_ankle_pitch_joint": 0.35,
  ".*_ankle_roll_joint": 0.15,
  "waist_yaw_joint": 0.3,
  "waist_roll_joint": 0.08,
  "waist_pitch_joint": 0.2,
  ".*_shoulder_pitch_joint": 0.5,
  ".*_shoulder_roll_joint": 0.2,
  ".*_shoulder_yaw_joint": 0.15,
  ".*_elbow_joint": 0.35,
  ".*_wrist_.*_joint": 0.3,
}


_ROBOT = LeggedRobot(
  entity=g1,
  action_scale=G1_ACTION_SCALE,
  torso="torso_link",
  feet=("left_foot", "right_foot"),
  foot_contact=ContactMatch(
    mode="subtree", pattern=("left_ankle_roll_link", "right_ankle_roll_link"), entity="robot", preserve_order=True
  ),
  foot_rays=RingPatternCfg(radius=0.03, num_samples=6),
  foot_friction=(geom_friction(".*_foot[1-7]_collision", (0.3, 1.2), axes=(0,), shared=True),),
  std_walking=STD_WALKING,
  std_running=STD_RUNNING,
  weights={"body_ang_vel": -0.05, "angular_momentum": -0.02},
  sim=physics(cone="pyramidal", impratio=1.0, ccd_iterations=50),
)


def _with_self_collision(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  cfg.scene.sensors["self_collision"] = self_collision("pelvis")
  cfg.rewards["self_collisions"] = RewardTermCfg(mdp.contact_count, weight=-1.0, params={"sensor": "self_collision"})
  return cfg


def g1_flat_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment on a plane."""
  return _with_self_collision(flat_env(_ROBOT))


def g1_rough_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment on rough ground."""
  return _with_self_collision(rough_env(_ROBOT, scan_body="pelvis"))


G1 = RobotTasks(
  experiment_name="g1_velocity",
  max_iterations=30_000,
  flat_env=g1_flat_env,
  rough_env=g1_rough_env,
  symmetry=left_right,
)
g1_flat, g1_flat_blind, g1_rough, g1_rough_blind = G1.flat, G1.flat_blind, G1.rough, G1.rough_blind
