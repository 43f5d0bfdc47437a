"""How a scene looks when nobody says otherwise."""

import mujoco

_OVERCAST = (0.72, 0.80, 0.90)
_ZENITH = (0.30, 0.45, 0.68)


def new_scene_spec() -> mujoco.MjSpec:
  """An empty scene: sky, haze, soft light with shadows, and a camera that looks down at the origin."""
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
  # Where shadows end, ground that is slanted to the light is speckled: out of sight.
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
  # One mean size for all scenes: marks of forces and contacts keep their size whatever the entities are.
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
