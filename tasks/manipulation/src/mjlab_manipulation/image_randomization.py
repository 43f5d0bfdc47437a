"""Randomisation of camera images between worlds: light, ground, texture, camera pose, delay."""

from dataclasses import replace

import mujoco
from mjlab_core import MjlabError
from mjlab_dr import Categorical, FieldRandomizer, randomize_field
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import (
  CameraNoiseCfg,
  EventMode,
  EventTermCfg,
  ObservationGroupCfg,
  ObservationTermCfg,
  SceneEntityCfg,
)

from mjlab_manipulation import mdp as lifting

# Camera of a world, drawn once: tolerances of mount and lens
CAMERA_SHIFT = 0.005  # m, along each axis
CAMERA_TURN = 0.035  # rad, about each axis
FOCAL_LENGTH = (0.97, 1.03)  # relative to the compiled value
LIGHT_SHIFT = 0.4  # m, along each axis

# The scene of an episode
BRIGHTNESS = (0.4, 1.2)  # relative to the compiled value
GROUND_TINT = (0.1, 0.7)
GROUND_SQUARES = (0.5, 8.0)  # relative to the compiled value

# The camera of an episode
GAIN, GAMMA, BIAS = (0.7, 1.3), (0.8, 1.25), (-0.05, 0.05)
COLOR_STD = (0.0, 0.03)
DEPTH_STD = (0.0, 0.01)  # of the range of depth, at its end
DISPARITY_STEP = (0.0, 0.01)  # of the inverse of the range of depth
HOLE_SHARE = (0.0, 0.1)
MAX_LAG = 2  # steps

# Grey, because the colour of the object is mixed in: pattern, mark, darker grey
TEXTURES = {
  "look_plain": ("FLAT", "NONE", 1.0),
  "look_checkered": ("CHECKER", "NONE", 0.35),
  "look_shaded": ("GRADIENT", "NONE", 0.3),
  "look_framed": ("FLAT", "EDGE", 1.0),
  "look_crossed": ("FLAT", "CROSS", 1.0),
  "look_speckled": ("FLAT", "RANDOM", 1.0),
}
LOOK = "look"
"""Name of the material of a free object, after the prefix of its entity."""
IMAGE_EVENTS = "image_"
"""Prefix of events that change images only."""

_CAMERA, _LIGHT, _GROUND = "camera_d405", "spotlight", "terrain"
_COLORS = ("red", "green", "blue")


def randomize_images(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  """Randomise the images of each world; return `cfg`, changed.

  The camera of each world is moved by up to 5 mm and turned by up to 2 degrees about each axis, with a focal length
  within 3 %. Images are up to two steps late, constant over an episode. With colours, each episode draws brightness,
  exposure, texture and tint of the ground, and texture of the object, and pixels are noisy. Depth is noisy, quantised,
  and has holes, which are far, not valid, and not part of the object.

  Raises:
    MjlabError: There are no images, or there are colours in a scene that has a `spec_fn`.
  """
  group, image = _images(cfg)
  if group is None or image is None:
    raise MjlabError("images are randomised in term 'image' of observation group 'camera', which does not exist")
  channels: tuple[lifting.Channel, ...] = image.params["channels"]
  focal = randomize_field("cam_intrinsic", _CAMERA, FOCAL_LENGTH, axes=("fx", "fy"), operation="scale", isotropic=True)
  cfg.events |= {
    "image_camera_pos": randomize_event(randomize_field("cam_pos", _CAMERA, (-CAMERA_SHIFT, CAMERA_SHIFT)), "startup"),
    "image_camera_turn": randomize_event(randomize_field("cam_quat", _CAMERA, (-CAMERA_TURN, CAMERA_TURN)), "startup"),
    "image_camera_focal": randomize_event(focal, "startup"),
  }
  if "rgb" in channels:
    _vary_looks(cfg)
  group.corrupt, image.noise = True, _camera_noise(channels)
  image.delay_max_lag, image.delay_hold_prob = MAX_LAG, 1.0
  return cfg


def plain_images(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  """Remove the randomisation and delay of images; return `cfg`, changed."""
  cfg.events = {name: event for name, event in cfg.events.items() if not name.startswith(IMAGE_EVENTS)}
  _, image = _images(cfg)
  if image is not None and isinstance(image.noise, CameraNoiseCfg):
    image.noise, image.delay_max_lag, image.delay_hold_prob = None, 0, 0.0
  return cfg


def add_looks(spec: mujoco.MjSpec) -> None:
  """Add grey textures, and give each free object a material for one of them; its colour is kept."""
  for name, (pattern, mark, dark) in TEXTURES.items():
    spec.add_texture(
      name=name,
      type=mujoco.mjtTexture.mjTEXTURE_2D,
      builtin=getattr(mujoco.mjtBuiltin, f"mjBUILTIN_{pattern}"),
      mark=getattr(mujoco.mjtMark, f"mjMARK_{mark}"),
      rgb1=(1.0, 1.0, 1.0),
      rgb2=(dark, dark, dark),
      markrgb=(0.1, 0.1, 0.1),
      random=0.1,
      width=64,
      height=64,
    )
  for body in spec.bodies:
    if not any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints):
      continue
    name = f"{body.name.split('/')[0]}/{LOOK}"
    material = spec.add_material(name=name)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = next(iter(TEXTURES))
    for geom in body.geoms:
      geom.material = name


def randomize_event(randomizer: FieldRandomizer, mode: EventMode, entity: str | None = "robot") -> EventTermCfg:
  """Return an event that draws a field of an entity; None: of the scene itself."""
  asset = None if entity is None else SceneEntityCfg(entity)
  return EventTermCfg(mdp.randomize, mode=mode, params={"randomizer": randomizer, "asset": asset})


def _vary_looks(cfg: ManagerBasedRlEnvCfg) -> None:
  if cfg.scene.spec_fn is not None:
    raise MjlabError("the scene has a spec_fn; call add_looks in it, and add the events")
  cfg.scene.spec_fn = add_looks
  texture = {"rgb": Categorical(tuple(TEXTURES))}
  light = randomize_field("light_diffuse", _LIGHT, BRIGHTNESS, operation="scale", isotropic=True)
  squares = randomize_field(
    "mat_texrepeat", _GROUND, GROUND_SQUARES, distribution="log_uniform", operation="scale", isotropic=True
  )
  cfg.events |= {
    "image_light_pos": randomize_event(randomize_field("light_pos", _LIGHT, (-LIGHT_SHIFT, LIGHT_SHIFT)), "startup"),
    "image_light": randomize_event(light, "reset"),
    "image_ground": randomize_event(randomize_field("mat_texid", _GROUND, texture), "reset", None),
    "image_ground_color": randomize_event(
      randomize_field("mat_rgba", _GROUND, GROUND_TINT, axes=_COLORS), "reset", None
    ),
    "image_ground_squares": randomize_event(squares, "reset", None),
  }
  commands = [command for command in cfg.commands.values() if isinstance(command, lifting.LiftCommandCfg)]
  for name in commands[0].objects if commands else ():
    cfg.events[f"image_{name}_texture"] = randomize_event(randomize_field("mat_texid", LOOK, texture), "reset", name)


def _camera_noise(channels: tuple[lifting.Channel, ...]) -> CameraNoiseCfg:
  noise, place = CameraNoiseCfg(), 0
  for channel in channels:
    if channel == "rgb":
      noise = replace(
        noise, color=(place, place + 1, place + 2), gain=GAIN, gamma=GAMMA, bias=BIAS, color_std=COLOR_STD
      )
    elif channel == "depth":
      noise = replace(noise, depth=place, depth_std=DEPTH_STD, disparity_step=DISPARITY_STEP, hole_share=HOLE_SHARE)
    else:
      noise = replace(noise, lost=(*noise.lost, place))
    place += 3 if channel == "rgb" else 1
  return noise


def _images(cfg: ManagerBasedRlEnvCfg) -> tuple[ObservationGroupCfg | None, ObservationTermCfg | None]:
  group = cfg.observations.get("camera")
  return group, None if group is None else group.terms.get("image")
