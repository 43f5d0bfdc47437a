"""Pictures of each robot in its default pose: `MUJOCO_GL=egl uv run python tools/picture_robots.py`.

Pictures show the primitives that are drawn without mesh files; `--meshes` shows the meshes instead.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
from mjlab_robots import YAM_DEFAULT_HEIGHT, MeshMode, g1_spec, go1_spec, go2_spec, yam_spec
from PIL import Image

ROBOTS: dict[str, Callable[[MeshMode], mujoco.MjSpec]] = {
  "go1": go1_spec,
  "go2": go2_spec,
  "g1": g1_spec,
  "yam": yam_spec,
}
# Width and height in pixels: as wide as the robot is.
SIZES = {"go1": (1200, 700), "go2": (1200, 700), "g1": (800, 900), "yam": (1000, 800)}
# Rendered larger and averaged: smoother edges than the renderer's own multisampling.
OVERSAMPLING = 2


def stage(spec: mujoco.MjSpec, size: tuple[int, int]) -> mujoco.MjModel:
  """Return the robot on a floor with sky and light; `stat.extent` stays that of the robot alone."""
  spec.stat.extent = spec.compile().stat.extent
  for light in list(spec.lights):
    spec.delete(light)
  spec.add_texture(
    name="sky",
    type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
    builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
    rgb1=[0.93, 0.95, 0.98],
    rgb2=[0.72, 0.8, 0.9],
    width=256,
    height=1536,
  )
  spec.add_texture(
    name="tiles",
    type=mujoco.mjtTexture.mjTEXTURE_2D,
    builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
    rgb1=[0.8, 0.82, 0.85],
    rgb2=[0.74, 0.76, 0.8],
    width=256,
    height=256,
  )
  floor = spec.add_material(name="floor", texrepeat=[2, 2], texuniform=True)
  floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
  spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[20, 20, 0.1], material="floor")
  sun = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
  spec.worldbody.add_light(type=sun, pos=[0.3, -0.3, 1.2], dir=[-0.25, 0.25, -1.0], diffuse=[0.6, 0.6, 0.6])
  spec.worldbody.add_light(type=sun, pos=[2, -2, 2], dir=[-1, 1, -0.4], castshadow=False, diffuse=[0.35, 0.35, 0.35])
  spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
  spec.visual.headlight.diffuse = [0.25, 0.25, 0.25]
  spec.visual.quality.shadowsize = 8192
  spec.visual.map.shadowclip = 2.5
  spec.visual.global_.offwidth = size[0] * OVERSAMPLING
  spec.visual.global_.offheight = size[1] * OVERSAMPLING
  return spec.compile()


def stand(model: mujoco.MjModel) -> mujoco.MjData:
  """Return the first keyframe, with the lowest colliding shape of a floating robot on the floor."""
  data = mujoco.MjData(model)
  mujoco.mj_resetDataKeyframe(model, data, 0)
  if model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
    model.body_pos[1, 2] = YAM_DEFAULT_HEIGHT
    mujoco.mj_forward(model, data)
    return data
  mujoco.mj_forward(model, data)
  floor = model.geom("floor").id
  gap = min(
    mujoco.mj_geomDistance(model, data, floor, geom, 1.0, None)
    for geom in range(model.ngeom)
    if geom != floor and model.geom_contype[geom]
  )
  data.qpos[2] -= gap
  mujoco.mj_forward(model, data)
  return data


def picture(model: mujoco.MjModel, data: mujoco.MjData, size: tuple[int, int]) -> Image.Image:
  camera = mujoco.MjvCamera()
  camera.lookat[:] = data.subtree_com[1] - [0.0, 0.0, 0.04]
  camera.distance, camera.azimuth, camera.elevation = 1.35 * model.stat.extent, 128.0, -14.0
  with mujoco.Renderer(model, size[1] * OVERSAMPLING, size[0] * OVERSAMPLING) as renderer:
    renderer.update_scene(data, camera)
    pixels = renderer.render()
  return Image.fromarray(np.asarray(pixels)).resize(size, Image.Resampling.LANCZOS)


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--meshes", action="store_true", help="wear meshes; fails where they are not found")
  parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "pictures")
  args = parser.parse_args()
  args.out.mkdir(parents=True, exist_ok=True)
  for name, spec_fn in ROBOTS.items():
    model = stage(spec_fn("require" if args.meshes else "never"), SIZES[name])
    path = args.out / f"{name}.png"
    picture(model, stand(model), SIZES[name]).save(path, optimize=True)
    print(path)


if __name__ == "__main__":
  main()
