"""Tracking tasks of the Unitree G1 on a plane."""

from mjlab_dr import geom_friction
from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_rl import RslRlOnPolicyRunnerCfg, TaskCfg
from mjlab_rl.offpolicy import OffPolicyRunnerCfg, SacCfg, fastsac
from mjlab_robots import G1_ACTION_SCALE, g1
from mjlab_sim import SimulationCfg

from mjlab_tracking.evaluation import TrackingEvaluation
from mjlab_tracking.flat import PHYSICS_DT, TrackedRobot, agent, flat_env, play

MOTION = "squat_and_wave"
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


def g1_flat() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of following a clip with state estimation."""
  return _task(g1_flat_env())


def g1_flat_no_state_estimation() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of following a clip without position and linear velocity of the base."""
  cfg = g1_flat_env()
  actor = cfg.observations["actor"]
  assert actor is not None
  for name in ("motion_anchor_pos_b", "base_lin_vel"):
    del actor.terms[name]
  return _task(cfg)


def g1_flat_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment; each call returns an independent copy."""
  robot = TrackedRobot(
    entity=g1,
    action_scale=G1_ACTION_SCALE,
    anchor="torso_link",
    bodies=BODIES,
    end_effectors=END_EFFECTORS,
    root="pelvis",
    foot_friction=geom_friction(".*_foot[1-7]_collision", (0.3, 1.2), axes=(0,), shared=True),
    sim=SimulationCfg(
      timestep=PHYSICS_DT,
      cone="pyramidal",
      impratio=1.0,
      iterations=10,
      ls_iterations=20,
      ccd_iterations=50,
    ),
  )
  return flat_env(robot, MOTION)


def _task(cfg: ManagerBasedRlEnvCfg) -> TaskCfg[ManagerBasedRlEnvCfg]:
  evaluator = TrackingEvaluation(end_effectors=END_EFFECTORS)
  ppo = agent("g1_tracking", 30_000)
  return TaskCfg(env=cfg, play=play, agent=ppo, agents={"fastsac": _fastsac(ppo)}, evaluator=evaluator)


def _fastsac(ppo: RslRlOnPolicyRunnerCfg) -> OffPolicyRunnerCfg:
  """Return FastSAC in its authors' settings for clips (holosoma): farther horizon, finer values, slower targets."""
  learner = fastsac(ppo)
  learner.algorithm = SacCfg(
    updates_per_step=4.0, policy_every=2, gamma=0.99, tau=0.05, num_atoms=501, target_entropy=-0.5
  )
  return learner
