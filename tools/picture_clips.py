"""Pictures of the clips that ship, as strips of poses: `MUJOCO_GL=egl uv run python tools/picture_clips.py`."""

import argparse
from pathlib import Path

import mujoco
import numpy as np
import torch
from mjlab_motions import load_motion, shipped_clips
from mjlab_robots import g1_spec, go1_spec
from picture_robots import OVERSAMPLING, stage
from PIL import Image

SIZE = (230, 330)  # pixels of one pose
POSES = 7


def strip(model: mujoco.MjModel, path: Path, *, height: float, distance: float, still: bool) -> Image.Image:
  """Poses at even times from the first frame to the last, seen from the front left.

  The camera looks at `height` above the ground [m], in the middle of the way or, with `still`, below a robot that is
  put back to where it began.
  """
  motion, data = load_motion(path), mujoco.MjData(model)
  camera = mujoco.MjvCamera()
  middle = motion.root_pos.mean(0).numpy()
  if still:
    middle[:2] = 0.0
  camera.lookat[:] = [middle[0], middle[1], height]
  camera.distance, camera.azimuth, camera.elevation = distance, 160.0, -8.0
  pictures = []
  with mujoco.Renderer(model, SIZE[1] * OVERSAMPLING, SIZE[0] * OVERSAMPLING) as renderer:
    for frame in np.linspace(0, motion.num_frames - 1, POSES + 2).round().astype(int)[1:-1]:
      data.qpos[:] = torch.cat((motion.root_pos[frame], motion.root_quat[frame], motion.joint_pos[frame]))
      if still:
        data.qpos[:2] = middle[:2]
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
  g1, go1 = stage(g1_spec("never"), SIZE), stage(go1_spec("never"), SIZE)
  for name, path in shipped_clips().items():
    if name.startswith("go1"):
      picture = strip(go1, path, height=0.2, distance=1.5, still=True)
    else:
      picture = strip(g1, path, height=0.69, distance=2.15, still=False)
    picture.quantize(128).save(folder / f"clip_{name}.png", optimize=True)
    print(folder / f"clip_{name}.png")


if __name__ == "__main__":
  main()
