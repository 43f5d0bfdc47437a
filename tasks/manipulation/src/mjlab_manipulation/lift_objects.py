"""Lift tasks with objects of many sizes, shapes, weights and surfaces, a different one in each world."""

from dataclasses import replace

from mjlab_dr import geom_friction, pseudo_inertia, randomize_field
from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_managers import ObservationTermCfg
from mjlab_rl import TaskCfg
from mjlab_scene import VariantEntityCfg

from mjlab_manipulation import mdp as lifting
from mjlab_manipulation.image_randomization import randomize_event, randomize_images
from mjlab_manipulation.lift import COMMAND, agent, hand, lift_env, lift_task
from mjlab_manipulation.objects import OBJECTS
from mjlab_manipulation.vision import see, vision_agent

OBJECT = "object"
"""Name of the entity."""

# Start positions at which the wrist camera sees all of the largest object
START = lifting.Region(x=(0.24, 0.38), y=(-0.09, 0.09), z=(0.0, 0.03))

# Per world, relative to the values of the object
MASS = (-0.35, 0.35)  # half the logarithm of the factor: half to twice as heavy
FRICTION = (0.5, 1.5)


def lift_objects() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of lifting the object of each world, with its size and pose observed."""
  return lift_task(lift_objects_env(), agent("yam_lift_objects", 5_000))


def lift_objects_depth() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of lifting the object of each world from randomised depth images."""
  return lift_task(lift_objects_depth_env(), vision_agent("yam_lift_objects_vision"))


def lift_objects_rgb() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of lifting the object of each world from colour images with randomised ground and light."""
  return lift_task(lift_objects_rgb_env(), vision_agent("yam_lift_objects_vision"))


def lift_objects_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment with many objects."""
  cfg = lift_env({OBJECT: VariantEntityCfg(variants=dict(OBJECTS))})
  cfg.commands[COMMAND] = lifting.LiftCommandCfg(objects=(OBJECT,), start=replace(START))
  for group in cfg.observations.values():
    assert group is not None
    group.terms |= {
      "object_size": ObservationTermCfg(lifting.object_size, scale=10.0, params={"command": COMMAND}),
      "object_in_hand": ObservationTermCfg(lifting.object_in_hand, params={"command": COMMAND, "hand": hand()}),
    }
  cfg.events |= {
    "object_mass": randomize_event(pseudo_inertia(".*", alpha=MASS), "startup", OBJECT),
    "object_friction": randomize_event(geom_friction(".*", FRICTION, shared=True), "startup", OBJECT),
  }
  return cfg


def lift_objects_depth_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment with many objects and randomised depth images."""
  return randomize_images(see(lift_objects_env(), ("depth",)))


def lift_objects_rgb_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment with many objects and randomised colour images."""
  cfg = see(lift_objects_env(), ("rgb",))
  color = randomize_field("geom_rgba", ".*", (0.0, 1.0), axes=("red", "green", "blue"), shared=True)
  cfg.events["object_color"] = randomize_event(color, "reset", OBJECT)
  return randomize_images(cfg)
