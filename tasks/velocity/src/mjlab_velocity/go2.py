"""Velocity tasks of the Unitree Go2 on flat and rough ground."""

from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_rl import TaskCfg
from mjlab_robots import GO2_ACTION_SCALE, go2

from mjlab_velocity.evaluation import VelocityEvaluation
from mjlab_velocity.legged import LeggedRobot, agent, flat_env, play_flat
from mjlab_velocity.quadruped import quadruped, quadruped_rough_env
from mjlab_velocity.rough import play_rough
from mjlab_velocity.sim_to_real import blind


def _robot() -> LeggedRobot:
  # The default pose reaches 18.4 mm below z = 0, so feet begin 1 to 5 cm above the ground.
  return quadruped(go2, GO2_ACTION_SCALE, "base", start_height=(0.0284, 0.0684))


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
  return quadruped_rough_env(_robot(), "(trunk|head|lidar)_collision")
