"""Spec of a scene: how it looks by default, and physics options merged from its parts."""

from collections.abc import Mapping

import mujoco
import numpy as np
from mjlab_core import MjlabError

_OVERCAST = (0.72, 0.80, 0.90)
_ZENITH = (0.30, 0.45, 0.68)
_SIZES = ("memory", "nuserdata", "nuser_body", "nuser_jnt", "nuser_geom", "nuser_site", "nuser_cam", "nuser_tendon")
_SIZES += ("nuser_actuator", "nuser_sensor")
_OPTIONS = tuple(
  name
  for name in dir(mujoco.MjSpec().option)
  if not name.startswith("_") and not callable(getattr(mujoco.MjSpec().option, name))
)


def new_scene_spec() -> mujoco.MjSpec:
  """Return an empty scene: sky, haze, soft light with shadows, and a camera that looks down at the origin."""
  spec = mujoco.MjSpec()
  spec.modelname = "scene"
  visual = spec.visual
  visual.headlight.ambient[:] = (0.35, 0.35, 0.35)
  visual.headlight.diffuse[:] = (0.45, 0.45, 0.45)
  visual.headlight.specular[:] = (0.05, 0.05, 0.05)
  visual.rgba.haze[:] = (*_OVERCAST, 1.0)
  visual.rgba.force[:] = (0.85, 0.20, 0.15, 1.0)
  visual.map.force = 0.005
  visual.map.haze = 0.25
  # Ground that is slanted to the light is speckled where shadows end, so they end out of sight.
  visual.map.shadowclip = 4.0
  visual.map.znear = 0.01
  visual.scale.forcewidth = 0.06
  visual.scale.contactwidth = 0.15
  visual.scale.contactheight = 0.03
  visual.scale.framelength = 0.6
  visual.quality.shadowsize = 8192
  visual.quality.offsamples = 8
  visual.global_.azimuth = 135
  visual.global_.elevation = -22
  visual.global_.offwidth = 1920
  visual.global_.offheight = 1080
  # All scenes have one mean size, so that marks of forces and contacts have the same size for all entities.
  spec.stat.meansize = 0.03
  spec.add_texture(
    name="sky",
    type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
    builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
    rgb1=_ZENITH,
    rgb2=_OVERCAST,
    width=512,
    height=512 * 6,
  )
  return spec


def merge_options(scene: mujoco.MjSpec, parts: Mapping[str, mujoco.MjSpec]) -> None:
  """Merge the options of parts, by name, into the scene's; then all agree in every option.

  MuJoCo does not propagate the options of an attached spec, and writes a warning where they differ. Here an option
  that a part sets to other than MuJoCo's default becomes the scene's.

  Raises:
    MjlabError: Two parts set the same option to different values; the message names both.
  """
  specs, default = (scene, *parts.values()), mujoco.MjSpec().option
  for option in _OPTIONS:
    value, setter = np.array(getattr(scene.option, option)), ""
    for name, part in parts.items():
      given = np.array(getattr(part.option, option))
      if np.array_equal(given, getattr(default, option)):
        continue
      if setter and not np.array_equal(given, value):
        raise MjlabError(
          f"option '{option}': {name} says {given.tolist()} and {setter} says {value.tolist()}; "
          "the worlds of a scene share their options, so set one of them to the other's value or to the default"
        )
      value, setter = given, name
    for spec in specs:
      setattr(spec.option, option, value if value.ndim else value.item())
  for size in _SIZES:
    largest = max(getattr(spec, size) for spec in specs)
    for spec in specs:
      setattr(spec, size, largest)
