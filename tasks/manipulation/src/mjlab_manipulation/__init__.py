"""Manipulation tasks: an arm lifts an object to a goal."""

from mjlab_manipulation.arm import LiftingArm, yam_arm
from mjlab_manipulation.distillation import (
  distillation_agent,
  lift_cube_depth_distill,
  lift_cube_rgb_distill,
  lift_objects_depth_distill,
  lift_objects_rgb_distill,
)
from mjlab_manipulation.evaluation import LiftEvaluation
from mjlab_manipulation.image_randomization import plain_images, randomize_images
from mjlab_manipulation.lift import agent, lift_cube, lift_cube_env, lift_cube_ik, lift_cube_ik_env, lift_env, play
from mjlab_manipulation.lift_objects import (
  lift_objects,
  lift_objects_depth,
  lift_objects_depth_env,
  lift_objects_env,
  lift_objects_rgb,
  lift_objects_rgb_env,
)
from mjlab_manipulation.vision import (
  lift_cube_depth,
  lift_cube_depth_env,
  lift_cube_rgb,
  lift_cube_rgb_env,
  multi_cube_seg,
  multi_cube_seg_env,
)

__all__ = [
  "LiftEvaluation",
  "LiftingArm",
  "agent",
  "distillation_agent",
  "lift_cube",
  "lift_cube_depth",
  "lift_cube_depth_distill",
  "lift_cube_depth_env",
  "lift_cube_env",
  "lift_cube_ik",
  "lift_cube_ik_env",
  "lift_cube_rgb",
  "lift_cube_rgb_distill",
  "lift_cube_rgb_env",
  "lift_env",
  "lift_objects",
  "lift_objects_depth",
  "lift_objects_depth_distill",
  "lift_objects_depth_env",
  "lift_objects_env",
  "lift_objects_rgb",
  "lift_objects_rgb_distill",
  "lift_objects_rgb_env",
  "multi_cube_seg",
  "multi_cube_seg_env",
  "plain_images",
  "play",
  "randomize_images",
  "yam_arm",
]
