"""Pictures of what camera sensors see, for the documentation: `uv run python tools/picture_cameras.py`.

A row is a world: the robot from behind, then colours, depth and segmentation of the camera on its head. Worlds differ
in the ground they stand on, in colours and in light, as they do under randomisation. It needs neither a GPU nor OpenGL.
"""

import argparse
from pathlib import Path

import matplotlib as mpl
import mujoco
import numpy as np
import torch
from matplotlib.colors import hsv_to_rgb
from mjlab_robots import go1
from mjlab_scene import EntityCfg, InitialStateCfg, Scene, SceneCfg
from mjlab_sensors import CameraSensorCfg
from mjlab_sim import Simulation, SimulationCfg
from mjlab_terrain import PyramidStairsCfg, RandomGridCfg, SteppingStonesCfg, TerrainGridCfg
from PIL import Image, ImageDraw, ImageFont

SIZE = (400, 300)
OVERSAMPLING = 2
GAP, TITLE = 6, 34
PAPER, INK = (255, 255, 255), (45, 52, 60)
MAX_DEPTH = 4.0

# Of each world: the tint of the robot, of the ground, of the lights, and how far the sun has turned about the vertical.
LOOKS = (
  ((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.7, 0.7, 0.7), 0.0),
  ((1.3, 0.75, 0.5), (0.8, 0.95, 0.75), (0.85, 0.65, 0.5), 1.4),
  ((0.55, 0.8, 1.3), (0.95, 0.8, 1.0), (0.4, 0.43, 0.55), 2.8),
)


def looking(position: tuple[float, float, float], at: tuple[float, float, float]) -> tuple[float, float, float, float]:
  """Orientation (w, x, y, z) of a camera that looks from one point at another, its image upright."""
  back = np.subtract(position, at) / np.linalg.norm(np.subtract(position, at))
  right = np.cross((0.0, 0.0, 1.0), back)
  right /= np.linalg.norm(right)
  quat = np.zeros(4)
  mujoco.mju_mat2Quat(quat, np.stack((right, np.cross(back, right), back), axis=1).flatten())
  return (float(quat[0]), float(quat[1]), float(quat[2]), float(quat[3]))


def camera(position: tuple[float, float, float], at: tuple[float, float, float], **fields) -> CameraSensorCfg:
  return CameraSensorCfg(
    body="robot/trunk", pos=position, quat=looking(position, at), geom_groups=(0, 1, 2), use_shadows=True, **fields
  )


def thing(geom: str, pos: tuple[float, float, float]) -> EntityCfg:
  xml = f'<mujoco><worldbody><body name="body"><freejoint/>{geom}</body></worldbody></mujoco>'
  return EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_string(xml), init_state=InitialStateCfg(pos=pos))


def scene_cfg() -> SceneCfg:
  wide, high = (OVERSAMPLING * side for side in SIZE)
  return SceneCfg(
    num_envs=len(LOOKS),
    terrain=TerrainGridCfg(
      tile_size=(6.0, 6.0),
      rows=1,
      columns=len(LOOKS),
      difficulty=(0.4, 0.4),
      border_width=3.0,
      layout="curriculum",
      types={"stairs": PyramidStairsCfg(inverted=True), "blocks": RandomGridCfg(), "stones": SteppingStonesCfg()},
      seed=2,
    ),
    entities={
      "robot": go1(),
      "ball": thing('<geom size="0.12" mass="0.3" rgba="0.85 0.3 0.25 1"/>', (0.75, 0.3, 0.12)),
      "crate": thing('<geom type="box" size="0.1 0.1 0.1" mass="0.3" rgba="0.25 0.5 0.75 1"/>', (0.75, -0.25, 0.1)),
    },
    sensors={
      "behind": camera((-0.75, -1.35, 0.8), (0.2, 0.0, -0.1), width=wide, height=high, fovy=48.0),
      "head": camera((0.3, 0.0, 0.08), (1.0, 0.0, -0.2), width=wide, height=high, fovy=70.0),
      "head_depth": camera(
        (0.3, 0.0, 0.08),
        (1.0, 0.0, -0.2),
        width=SIZE[0],
        height=SIZE[1],
        fovy=70.0,
        data_types=("depth", "segmentation"),
      ),
    },
  )


def dress(sim: Simulation) -> None:
  """Every world in its own colours and light."""
  model = sim.mj_model
  sim.expand_model_fields(["mat_rgba", "geom_rgba", "light_diffuse", "light_dir"])
  grounds = [geom for geom in range(model.ngeom) if model.body_weldid[model.geom_bodyid[geom]] == 0]
  materials = [number for number in range(model.nmat) if model.material(number).name.startswith("robot/")]
  for world, (robot, ground, light, turn) in enumerate(LOOKS):
    for rows, field, tint in ((materials, "mat_rgba", robot), (grounds, "geom_rgba", ground)):
      colors = sim.model[field]
      colors[world, rows, :3] = (colors[world, rows, :3] * torch.tensor(tint)).clamp(max=1.0)
    sim.model.light_diffuse[world] *= torch.tensor(light)
    cos, sin = np.cos(turn), np.sin(turn)
    rotation = torch.tensor([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]], dtype=sim.model.light_dir.dtype)
    sim.model.light_dir[world] = sim.model.light_dir[world] @ rotation.T


def colored_depth(depth: np.ndarray) -> Image.Image:
  """Near is bright, and far is dark; the sky is white."""
  colors = mpl.colormaps["magma_r"](np.clip(depth / MAX_DEPTH, 0.0, 1.0) * 0.92)[..., :3]
  colors[depth < 0.0] = 1.0
  return Image.fromarray(np.round(255.0 * colors).astype(np.uint8))


def colored_objects(numbers: np.ndarray, model: mujoco.MjModel) -> Image.Image:
  """Return a colour for each visible geom, strong for those that move and pale for the ground; the sky is white."""
  page = np.full((*numbers.shape, 3), 255, dtype=np.uint8)
  for geom in np.unique(numbers[numbers >= 0]):
    moves = model.body_weldid[model.geom_bodyid[geom]] != 0
    # Hues that follow each other by the golden ratio are far apart however many there are.
    hue, strength = (0.618034 * geom) % 1.0, (0.75, 0.85) if moves else (0.15, 0.95)
    page[numbers == geom] = np.round(255.0 * hsv_to_rgb((hue, *strength)))
  return Image.fromarray(page)


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "pictures")
  args = parser.parse_args()
  scene = Scene(scene_cfg())
  sim = Simulation(scene.num_envs, scene.spec, SimulationCfg(timestep=0.005))
  scene.initialize(sim)
  dress(sim)
  for _ in range(200):
    scene.write_ctrl()
    sim.step()

  def shrunk(sensor: str, world: int) -> Image.Image:
    pixels = scene[sensor].data.rgb[world].permute(1, 2, 0).numpy()
    return Image.fromarray(pixels).resize(SIZE, Image.Resampling.LANCZOS)

  titles = ("from behind", "head camera: rgb", f"depth, 0 to {MAX_DEPTH:g} m", "segmentation")
  page = Image.new("RGB", (len(titles) * (SIZE[0] + GAP) - GAP, len(LOOKS) * (SIZE[1] + GAP) - GAP + TITLE), PAPER)
  draw, font = ImageDraw.Draw(page), ImageFont.load_default(size=20)
  for column, title in enumerate(titles):
    draw.text((column * (SIZE[0] + GAP) + SIZE[0] / 2, TITLE / 2 - 2), title, font=font, fill=INK, anchor="mm")
  images = scene["head_depth"].data
  for world in range(scene.num_envs):
    row = (
      shrunk("behind", world),
      shrunk("head", world),
      colored_depth(images.depth[world, 0].numpy()),
      colored_objects(images.segmentation[world, 0].numpy(), sim.mj_model),
    )
    for column, image in enumerate(row):
      page.paste(image, (column * (SIZE[0] + GAP), TITLE + world * (SIZE[1] + GAP)))
  args.out.mkdir(parents=True, exist_ok=True)
  path = args.out / "cameras.png"
  page.save(path, optimize=True)
  print(path)


if __name__ == "__main__":
  main()
