"""Lift tasks: the environment of any arm, and those of the YAM with one cube, with joint or Cartesian actions."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

from mjlab_dr import geom_friction
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
from mjlab_rl import RslRlBaseRunnerCfg, RslRlOnPolicyRunnerCfg, TaskCfg, control_agent
from mjlab_scene import EntityCfg, SceneCfg
from mjlab_sensors import ContactMatch, ContactSensorCfg, SensorCfg
from mjlab_sim import SimulationCfg
from mjlab_terrain import PlaneCfg

from mjlab_manipulation import mdp as lifting
from mjlab_manipulation.arm import ARM, JOINT_RANGE, LiftingArm, yam_arm
from mjlab_manipulation.evaluation import LiftEvaluation
from mjlab_manipulation.image_randomization import plain_images
from mjlab_manipulation.objects import cube_spec

# Timing
PHYSICS_DT = 0.005  # s
DECIMATION = 4
EPISODE_LENGTH = 20.0  # s; goals end before

# Cartesian actions: change of pose per unit of action and step, and opening of the gripper
HAND_STEP = 0.02  # m
HAND_TURN = 0.1  # rad
GRIPPER_OPEN, GRIPPER_CLOSED = 0.0375, 0.0  # m

# Rewards
REACHING_STD, BRINGING_STD, PRECISE_STD = 0.2, 0.3, 0.05  # m
MAX_JOINT_SPEED = 0.5  # rad/s
JOINT_SPEED_WEIGHTS = {0: -0.01, 500 * 24: -0.1, 1000 * 24: -1.0}  # from environment steps on

# Success and its stages
TOLERANCE = 0.05  # m
HOLD = 1.0  # s
REACHED = 0.05  # m
LIFTED, FALLEN = 0.06, 0.01  # m, height of the object's lowest point

# A greater force on the ground ends the episode
MAX_GROUND_FORCE = 10.0  # N

# Noise of the observations
NOISE_JOINT_POS = UniformNoiseCfg(n_min=-0.01, n_max=0.01)
NOISE_JOINT_VEL = UniformNoiseCfg(n_min=-1.5, n_max=1.5)
NOISE_POSITION = UniformNoiseCfg(n_min=-0.01, n_max=0.01)

COMMAND = "lift_height"


def lift_cube() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of lifting a cube to a goal with joint position actions."""
  return lift_task(lift_cube_env(), agent("yam_lift_cube", 5_000))


def lift_cube_ik() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of lifting a cube to a goal with Cartesian actions through inverse kinematics."""
  return lift_task(lift_cube_ik_env(), agent("yam_lift_cube_ik", 5_000))


def lift_task(env: ManagerBasedRlEnvCfg, learner: RslRlBaseRunnerCfg) -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of a lift environment and its learner."""
  return TaskCfg(env=env, play=play, agent=learner, evaluator=LiftEvaluation())


def lift_cube_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment with joint actions; each call returns an independent copy."""
  return lift_env({"cube": EntityCfg(spec_fn=cube_spec)})


def lift_cube_ik_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment with Cartesian actions."""
  cfg = lift_cube_env()
  cfg.actions = {
    "hand": mdp.DifferentialIKActionCfg(
      actuators=ARM,
      frame_type="site",
      frame_name="grasp_site",
      relative_to="goal",
      delta_pos_scale=HAND_STEP,
      delta_ori_scale=HAND_TURN,
      joint_limit_weight=1.0,
      clip={joint: JOINT_RANGE[joint] for joint in ARM},
    ),
    "gripper": mdp.BinaryJointPositionActionCfg(
      actuators="left_finger", open={"left_finger": GRIPPER_OPEN}, close={"left_finger": GRIPPER_CLOSED}
    ),
  }
  return cfg


def lift_env(objects: dict[str, EntityCfg], arm: LiftingArm | None = None) -> ManagerBasedRlEnvCfg:
  """Return the environment of an arm on a plane with joint actions; each call returns an independent copy.

  Args:
    objects: Entities of one body each; every world lifts one of them.
    arm: The arm; None: a YAM.
  """
  arm = yam_arm() if arm is None else arm
  return ManagerBasedRlEnvCfg(
    decimation=DECIMATION,
    episode_length_s=EPISODE_LENGTH,
    sim=SimulationCfg(timestep=PHYSICS_DT, cone="elliptic", impratio=10.0, iterations=10, ls_iterations=20),
    scene=SceneCfg(
      env_spacing=1.0,
      terrain=PlaneCfg(),
      entities={"robot": arm.entity(), **objects},
      sensors=_sensors(tuple(objects), arm),
      extent=1.0,
    ),
    actions={
      "joint_pos": mdp.JointPositionActionCfg(actuators=".*", scale=dict(arm.action_scale), clip=dict(arm.joint_range))
    },
    commands={COMMAND: lifting.LiftCommandCfg(objects=tuple(objects))},
    observations={
      "actor": state_observations(arm.hand_site, corrupt=True),
      "critic": state_observations(arm.hand_site, corrupt=False),
    },
    rewards=_rewards(arm),
    terminations={
      "time_out": TerminationTermCfg(mdp.time_out, time_out=True),
      "goal_over": TerminationTermCfg(lifting.goal_over, time_out=True, params={"command": COMMAND}),
      "ee_ground_collision": TerminationTermCfg(
        mdp.illegal_contact, params={"sensor": "ee_ground_collision", "threshold": MAX_GROUND_FORCE}
      ),
    },
    events={
      "reset_robot_joints": EventTermCfg(
        mdp.reset_joints_by_offset,
        mode="reset",
        params={"position_range": (0.0, 0.0), "velocity_range": (0.0, 0.0)},
      ),
      **_tip_friction(arm.finger_tips),
    },
    curriculum={
      "joint_vel_hinge_weight": CurriculumTermCfg(
        mdp.reward_curriculum,
        params={
          "reward": "joint_vel_hinge",
          "stages": [mdp.Stage(step=step, weight=weight) for step, weight in JOINT_SPEED_WEIGHTS.items()],
        },
      )
    },
    metrics=_metrics(arm.hand_site),
  )


def hand(site: str = "grasp_site") -> SceneEntityCfg:
  """Return the site between the finger tips; by default the YAM's."""
  return SceneEntityCfg("robot", site_names=site)


def _sensors(objects: tuple[str, ...], arm: LiftingArm) -> dict[str, SensorCfg]:
  return {
    "ee_ground_collision": ContactSensorCfg(
      primary=ContactMatch(mode="subtree", pattern=arm.wrist, entity="robot"),
      secondary=ContactMatch(mode="body", pattern="terrain"),
      fields=("found", "force"),
      reduce="maxforce",
      history_length="decimation",
    ),
    "fingers": ContactSensorCfg(
      primary=ContactMatch(mode="subtree", pattern=arm.fingers, entity="robot", preserve_order=True),
      secondary=ContactMatch(mode="body", pattern=tuple(f"{name}/.*" for name in objects), preserve_order=True),
      fields=("found", "force"),
      # The force of a finger, summed over its contacts.
      reduce="netforce",
      history_length="decimation",
    ),
  }


def proprioception() -> dict[str, ObservationTermCfg | None]:
  """Return proprioceptive terms: joints, those of the fingers too, and the last action."""
  return {
    "joint_pos": ObservationTermCfg(mdp.joint_pos_rel, noise=replace(NOISE_JOINT_POS)),
    "joint_vel": ObservationTermCfg(mdp.joint_vel_rel, noise=replace(NOISE_JOINT_VEL)),
    "actions": ObservationTermCfg(mdp.last_action),
  }


def state_observations(hand_site: str, *, corrupt: bool) -> ObservationGroupCfg:
  """Return terms of the arm, the object and the goal."""
  terms = proprioception()
  terms |= {
    "ee_to_cube": ObservationTermCfg(
      lifting.hand_to_object, noise=replace(NOISE_POSITION), params={"command": COMMAND, "hand": hand(hand_site)}
    ),
    "cube_to_goal": ObservationTermCfg(
      lifting.object_to_goal, noise=replace(NOISE_POSITION), params={"command": COMMAND}
    ),
  }
  # Policies expect the last action at the end.
  terms["actions"] = terms.pop("actions")
  return ObservationGroupCfg(corrupt=corrupt, terms=terms)


def _rewards(arm: LiftingArm) -> dict[str, RewardTermCfg | None]:
  return {
    "lift": RewardTermCfg(
      lifting.lift,
      weight=1.0,
      params={
        "command": COMMAND,
        "reaching_std": REACHING_STD,
        "bringing_std": BRINGING_STD,
        "hand": hand(arm.hand_site),
      },
    ),
    "lift_precise": RewardTermCfg(lifting.lift_precise, weight=1.0, params={"command": COMMAND, "std": PRECISE_STD}),
    "action_rate_l2": RewardTermCfg(mdp.action_rate_l2, weight=-0.01),
    "joint_pos_limits": RewardTermCfg(mdp.joint_pos_limits, weight=-10.0),
    "joint_vel_hinge": RewardTermCfg(
      lifting.joint_vel_hinge,
      weight=JOINT_SPEED_WEIGHTS[0],
      params={"max_vel": MAX_JOINT_SPEED, "asset": SceneEntityCfg("robot", joint_names=arm.arm_joints)},
    ),
  }


def _metrics(hand_site: str) -> dict[str, MetricsTermCfg | None]:
  def metric(
    func: Callable[..., Any], reduce: Literal["mean", "last", "max"] = "mean", **params: object
  ) -> MetricsTermCfg:
    return MetricsTermCfg(func, reduce=reduce, params={"command": COMMAND, **params})

  return {
    "reached": metric(lifting.reached, "max", hand=hand(hand_site), within=REACHED),
    "touched": metric(lifting.touched, "max", sensor="fingers"),
    "grasped": metric(lifting.grasped, "max", sensor="fingers"),
    "lifted": metric(lifting.lifted, "max", height=LIFTED),
    "held": metric(lifting.held, "max", within=TOLERANCE, hold=HOLD),
    "dropped": metric(lifting.dropped, "last", low=FALLEN, high=LIFTED),
    "time_to_success": metric(lifting.time_to_success, "last", within=TOLERANCE, hold=HOLD),
    "finger_force": metric(lifting.finger_force, "max", sensor="fingers"),
    "at_goal": metric(lifting.at_goal, within=TOLERANCE),
    "position_error": metric(lifting.position_error),
    "object_height": metric(lifting.object_height),
  }


def _tip_friction(tips: str | None) -> dict[str, EventTermCfg | None]:
  if tips is None:
    return {}
  # One value for all finger tips of a world, which are of one material.
  randomizers = {
    "slide": geom_friction(tips, (0.3, 1.5), axes=(0,), shared=True),
    "spin": geom_friction(tips, (1e-4, 2e-2), axes=(1,), distribution="log_uniform", shared=True),
    "roll": geom_friction(tips, (1e-5, 5e-3), axes=(2,), distribution="log_uniform", shared=True),
  }
  return {
    f"fingertip_friction_{axis}": mdp.randomize_at_startup(randomizer) for axis, randomizer in randomizers.items()
  }


def play(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  """Return the play config: a new goal every 4 s, no noise, and the same images in all worlds."""
  plain_images(cfg)
  cfg.episode_length_s = 1e9
  for group in cfg.observations.values():
    if group is not None:
      group.corrupt = False
  cfg.curriculum = {}
  command = cfg.commands[COMMAND]
  if isinstance(command, lifting.LiftCommandCfg):
    command.goal_time_range = (4.0, 4.0)
  return cfg


def agent(experiment_name: str, max_iterations: int) -> RslRlOnPolicyRunnerCfg:
  """Return the learner of policies that observe the pose of the object."""
  return control_agent(experiment_name, max_iterations, save_interval=100)
