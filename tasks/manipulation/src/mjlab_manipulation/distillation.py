"""Students that see learn from a teacher that is told where the cube is."""

from dataclasses import replace

from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_rl import RslRlDistillationRunnerCfg, TaskCfg

from mjlab_manipulation.evaluation import LiftEvaluation
from mjlab_manipulation.lift import play
from mjlab_manipulation.lift_objects import lift_objects_depth_env, lift_objects_rgb_env
from mjlab_manipulation.vision import lift_cube_depth_env, lift_cube_rgb_env, vision_agent

ITERATIONS = 1_000
# About how far the student strays from what it has learned, so that it is told the way back.
INIT_STD = 0.1


def lift_cube_depth_distill() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """The YAM learns to lift a cube whose distance it sees, from a policy of `Mjlab-Lift-Cube-Yam`."""
  return _task(lift_cube_depth_env(), "yam_lift_cube_distill", "Mjlab-Lift-Cube-Yam")


def lift_cube_rgb_distill() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """The YAM learns to lift a cube that it sees in colour, from a policy of `Mjlab-Lift-Cube-Yam`."""
  return _task(lift_cube_rgb_env(), "yam_lift_cube_distill", "Mjlab-Lift-Cube-Yam")


def lift_objects_depth_distill() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """The YAM learns to lift any object whose distance it sees, from a policy of `Mjlab-Lift-Objects-Yam`."""
  return _task(lift_objects_depth_env(), "yam_lift_objects_distill", "Mjlab-Lift-Objects-Yam")


def lift_objects_rgb_distill() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """The YAM learns to lift any object that it sees in colour, from a policy of `Mjlab-Lift-Objects-Yam`."""
  return _task(lift_objects_rgb_env(), "yam_lift_objects_distill", "Mjlab-Lift-Objects-Yam")


def _task(env: ManagerBasedRlEnvCfg, experiment_name: str, teacher: str) -> TaskCfg[ManagerBasedRlEnvCfg]:
  # The critic was told what the teacher saw, without noise; there is no critic here.
  env.observations["teacher"] = env.observations.pop("critic")
  # Nothing is learned from rewards here: they are looked at, and mean the same from the first iteration to the last.
  env.curriculum = {}
  return TaskCfg(env=env, play=play, agent=distillation_agent(experiment_name, teacher), evaluator=LiftEvaluation())


def distillation_agent(experiment_name: str, teacher: str) -> RslRlDistillationRunnerCfg:
  """The learner of students of a task's policies, with the network of those that learn to see by themselves."""
  seeing = vision_agent(experiment_name)
  return RslRlDistillationRunnerCfg(
    experiment_name=experiment_name,
    obs_groups={"student": seeing.obs_groups["actor"], "teacher": ("teacher",)},
    student=replace(
      seeing.actor, distribution_cfg={"class_name": "GaussianDistribution", "init_std": INIT_STD, "std_type": "scalar"}
    ),
    teacher_task=teacher,
    num_steps_per_env=seeing.num_steps_per_env,
    max_iterations=ITERATIONS,
    save_interval=seeing.save_interval,
  )
