"""Draws the clips that ship as strips of poses: `MUJOCO_GL=egl uv run python tools/picture_clips.py`."""

import argparse
from pathlib import Path

import mujoco
import numpy as np
import torch
from mjlab_robots import g1_spec
from mjlab_tracking import load_motion, shipped_clips
from picture_robots import OVERSAMPLING, stage
from PIL import Image

SIZE = (230, 330)  # pixels of one pose
POSES = 7


def strip(model: mujoco.MjModel, path: Path) -> Image.Image:
  """Poses at even times from the first frame to the last, seen from the front left."""
  motion, data = load_motion(path), mujoco.MjData(model)
  camera = mujoco.MjvCamera()
  middle = motion.root_pos.mean(0).numpy()
  camera.lookat[:] = [middle[0], middle[1], 0.69]
  camera.distance, camera.azimuth, camera.elevation = 2.15, 160.0, -8.0
  pictures = []
  with mujoco.Renderer(model, SIZE[1] * OVERSAMPLING, SIZE[0] * OVERSAMPLING) as renderer:
    for frame in np.linspace(0, motion.num_frames - 1, POSES + 2).round().astype(int)[1:-1]:
      data.qpos[:] = torch.cat((motion.root_pos[frame], motion.root_quat[frame], motion.joint_pos[frame]))
      mujoco.mj_forward(model, data)
      renderer.update_scene(data, camera)
      pictures.append(Image.fromarray(renderer.render()).resize(SIZE, Image.Resampling.LANCZOS))
  whole = Image.new("RGB", (SIZE[0] * POSES, SIZE[1]))
  for i, picture in enumerate(pictures):
    whole.paste(picture, (i * SIZE[0], 0))
  return whole


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  here = Path(__file__).parents[1] / "docs" / "pictures"
  parser.add_argument("folder", nargs="?", type=Path, default=here)
  folder = parser.parse_args().folder
  model = stage(g1_spec("never"), SIZE)
  for name, path in shipped_clips().items():
    strip(model, path).quantize(128).save(folder / f"clip_{name}.png", optimize=True)
    print(folder / f"clip_{name}.png")


if __name__ == "__main__":
  main()
