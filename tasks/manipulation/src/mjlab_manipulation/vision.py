"""Lift tasks from images of the wrist camera."""

import copy
from dataclasses import replace

from mjlab_dr import randomize_field
from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_managers import ObservationGroupCfg, ObservationTermCfg
from mjlab_rl import RslRlModelCfg, RslRlOnPolicyRunnerCfg, TaskCfg
from mjlab_scene import EntityCfg
from mjlab_sensors import CameraSensorCfg
from mjlab_terrain import PlaneCfg

from mjlab_manipulation import mdp as lifting
from mjlab_manipulation.image_randomization import randomize_event
from mjlab_manipulation.lift import COMMAND, agent, hand, lift_cube_env, lift_env, lift_task, proprioception
from mjlab_manipulation.objects import CUBES

# Images
CAMERA = "wrist_camera"
PIXELS = 32  # of each side
DEPTH_RANGE = (0.01, 0.5)  # m
# Visible groups: ground, cubes, and the robot's collision shapes, which do not depend on mesh files.
GEOM_GROUPS = (0, 3)

# Cubes beside one another
CUBES_START = lifting.Region(x=(0.25, 0.4), y=(-0.103, 0.103), z=(0.0, 0.03))

# Learner
ENCODER = {
  "output_channels": (16, 32),
  "kernel_size": (5, 3),
  "stride": (2, 2),
  "padding": "zeros",
  "activation": "elu",
}
HIDDEN = (256, 256, 128)
ITERATIONS = 3_000


def lift_cube_depth() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of lifting a cube from depth images."""
  return lift_task(lift_cube_depth_env(), vision_agent("yam_lift_cube_vision"))


def lift_cube_rgb() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of lifting a cube from colour images, with a random cube colour in each episode."""
  return lift_task(lift_cube_rgb_env(), vision_agent("yam_lift_cube_vision"))


def multi_cube_seg() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of lifting the marked one of three cubes."""
  return lift_task(multi_cube_seg_env(), vision_agent("yam_multi_cube_seg"))


def lift_cube_depth_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment with depth images."""
  return see(lift_cube_env(), ("depth",))


def lift_cube_rgb_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment with colour images."""
  cfg = see(lift_cube_env(), ("rgb",))
  color = randomize_field("geom_rgba", "cube", (0.0, 1.0), axes=("red", "green", "blue"), operation="absolute")
  cfg.events["cube_color"] = randomize_event(color, "reset", "cube")
  return cfg


def multi_cube_seg_env() -> ManagerBasedRlEnvCfg:
  """Return the training environment with three cubes, depth images and a mask of the target."""
  cfg = lift_env({name: EntityCfg(spec_fn=spec_fn) for name, spec_fn in CUBES.items()})
  cfg.commands[COMMAND] = lifting.LiftCommandCfg(objects=tuple(CUBES), start=replace(CUBES_START))
  return see(cfg, ("depth", "object"))


def see(cfg: ManagerBasedRlEnvCfg, channels: tuple[lifting.Channel, ...]) -> ManagerBasedRlEnvCfg:
  """Replace the actor's cube terms by a camera and the goal; return `cfg`, changed. The critic keeps its terms."""
  cfg.scene.sensors[CAMERA] = CameraSensorCfg(
    camera="robot/camera_d405",
    width=PIXELS,
    height=PIXELS,
    data_types=tuple(dict.fromkeys(lifting.DATA_OF_CHANNEL[channel] for channel in channels)),
    geom_groups=GEOM_GROUPS,
  )
  if "rgb" in channels:
    # The robot has a lamp; with the light of the ground, bright colours would be white.
    cfg.scene.terrain = PlaneCfg(light=False)
  terms = proprioception()
  terms["goal_position"] = ObservationTermCfg(lifting.goal_in_hand, params={"command": COMMAND, "hand": hand()})
  cfg.observations["actor"] = ObservationGroupCfg(corrupt=True, terms=terms)
  cfg.observations["camera"] = ObservationGroupCfg(
    terms={
      "image": ObservationTermCfg(
        lifting.camera_image,
        params={"sensor": CAMERA, "channels": channels, "depth_range": DEPTH_RANGE, "command": COMMAND},
      )
    }
  )
  return cfg


def vision_agent(experiment_name: str) -> RslRlOnPolicyRunnerCfg:
  """Return the learner of vision policies: the actor has an image encoder, the critic observes poses."""
  cfg = agent(experiment_name, ITERATIONS)
  cfg.actor = replace(
    cfg.actor,
    class_name="mjlab_rl.models.spatial_softmax:SpatialSoftmaxCNNModel",
    cnn_cfg=copy.deepcopy(ENCODER),
    hidden_dims=HIDDEN,
  )
  cfg.critic = RslRlModelCfg(hidden_dims=HIDDEN, obs_normalization=True)
  cfg.obs_groups = {"actor": ("actor", "camera"), "critic": ("critic",)}
  return cfg
