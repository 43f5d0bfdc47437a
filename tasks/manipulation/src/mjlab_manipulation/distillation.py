"""Distillation tasks: students with camera images learn from a teacher that knows the pose of the object."""

from dataclasses import replace

from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_rl import RslRlDistillationRunnerCfg, TaskCfg

from mjlab_manipulation.lift import lift_task
from mjlab_manipulation.lift_objects import lift_objects_depth_env, lift_objects_rgb_env
from mjlab_manipulation.vision import lift_cube_depth_env, lift_cube_rgb_env, vision_agent

ITERATIONS = 1_000
# Noise of the student, so that the teacher shows how to recover.
INIT_STD = 0.1


def lift_cube_depth_distill() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of a student that lifts a cube from depth images; teacher: `Mjlab-Lift-Cube-Yam`."""
  return _task(lift_cube_depth_env(), "yam_lift_cube_distill", "Mjlab-Lift-Cube-Yam")


def lift_cube_rgb_distill() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of a student that lifts a cube from colour images; teacher: `Mjlab-Lift-Cube-Yam`."""
  return _task(lift_cube_rgb_env(), "yam_lift_cube_distill", "Mjlab-Lift-Cube-Yam")


def lift_objects_depth_distill() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of a student that lifts objects from depth images; teacher: `Mjlab-Lift-Objects-Yam`."""
  return _task(lift_objects_depth_env(), "yam_lift_objects_distill", "Mjlab-Lift-Objects-Yam")


def lift_objects_rgb_distill() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of a student that lifts objects from colour images; teacher: `Mjlab-Lift-Objects-Yam`."""
  return _task(lift_objects_rgb_env(), "yam_lift_objects_distill", "Mjlab-Lift-Objects-Yam")


def _task(env: ManagerBasedRlEnvCfg, experiment_name: str, teacher: str) -> TaskCfg[ManagerBasedRlEnvCfg]:
  # The teacher observes what a critic observes, without noise. Distillation has no critic.
  env.observations["teacher"] = env.observations.pop("critic")
  # Rewards are only logged, so they keep one meaning over the training.
  env.curriculum = {}
  return lift_task(env, distillation_agent(experiment_name, teacher))


def distillation_agent(experiment_name: str, teacher: str) -> RslRlDistillationRunnerCfg:
  """Return the learner of students, with the same network as the vision tasks without a teacher."""
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
