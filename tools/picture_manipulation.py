"""Pictures of what the policies that lift see, for the documentation: `uv run python tools/picture_manipulation.py`.

Two pictures: the plain tasks, and images that differ from world to world. A row for each channel, a column for each
world, as they begin: 32 x 32 pixels beside the title, and enlarged. It needs neither a GPU nor OpenGL.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab_manipulation import (
  lift_cube_depth_env,
  lift_cube_rgb_env,
  lift_objects_depth_env,
  lift_objects_rgb_env,
  multi_cube_seg_env,
  randomize_images,
)
from mjlab_manipulation.vision import DEPTH_RANGE
from PIL import Image, ImageDraw, ImageFont

WORLDS = 6
ENLARGED = 5
GAP = 1
TITLE = 40
NEAR, FAR = 0.1, 0.4  # m, black and white
NOTHING = (0.75, 0.25, 0.2)

DEPTH = f"depth, black {NEAR} m, white {FAR} m, red far or unknown"
Rows = list[tuple[str, slice]]


def random_multi_cube_seg_env() -> ManagerBasedRlEnvCfg:
  return randomize_images(multi_cube_seg_env())


PICTURES: dict[str, list[tuple[str, Callable[[], ManagerBasedRlEnvCfg], int, Rows]]] = {
  "manipulation": [
    ("Lift-Cube-Yam-Depth", lift_cube_depth_env, 1, [(DEPTH, slice(0, 1))]),
    ("Lift-Cube-Yam-Rgb", lift_cube_rgb_env, 1, [("colours", slice(0, 3))]),
    ("Multi-Cube-Seg-Yam", multi_cube_seg_env, 1, [(DEPTH, slice(0, 1)), ("mask of the one meant", slice(1, 2))]),
  ],
  "manipulation_randomized": [
    ("Lift-Objects-Yam-Rgb", lift_objects_rgb_env, 3, [("colours", slice(0, 3))]),
    ("Lift-Objects-Yam-Depth", lift_objects_depth_env, 2, [(DEPTH, slice(0, 1))]),
    ("Multi-Cube-Seg-Yam", random_multi_cube_seg_env, 1, [(DEPTH, slice(0, 1)), ("mask", slice(1, 2))]),
  ],
}


def look(make: Callable[[], ManagerBasedRlEnvCfg], num_envs: int) -> np.ndarray:
  """Return the first image of each world, (num_envs, channels, height, width) in [0, 1]."""
  cfg = make()
  cfg.scene.num_envs, cfg.seed = num_envs, 3
  with ManagerBasedRlEnv(cfg, device="cpu") as env:
    observations, _ = env.reset(seed=3)
    return torch.as_tensor(observations["camera"]).numpy()


def colored(images: np.ndarray, name: str) -> np.ndarray:
  """Images (n, 1 or 3, h, w) as colours, (n, h, w, 3): depth of what is near enough between black and white."""
  pixels = np.broadcast_to(images, (len(images), 3, *images.shape[2:])).transpose(0, 2, 3, 1)
  if name != DEPTH:
    return pixels
  grey = ((pixels * DEPTH_RANGE[1] - NEAR) / (FAR - NEAR)).clip(0.0, 1.0)
  return np.where(pixels >= 1.0, NOTHING, grey)


def row(images: np.ndarray, title: str) -> np.ndarray:
  """Images (n, h, w, 3) beside one another, under a title and themselves in their true size."""
  parted = np.pad(images, ((0, 0), (0, 0), (0, GAP), (0, 0)), constant_values=1.0)
  beside = (np.concatenate(list(parted), axis=1)[:, :-GAP] * 255).astype(np.uint8)
  enlarged = beside.repeat(ENLARGED, 0).repeat(ENLARGED, 1)
  paper = Image.new("RGB", (enlarged.shape[1], TITLE), (255, 255, 255))
  ImageDraw.Draw(paper).text((4, 14), title, fill=(45, 52, 60), font=ImageFont.load_default(15))
  head = np.asarray(paper).copy()
  head[4 : 4 + len(beside), -beside.shape[1] :] = beside
  return np.concatenate([head, enlarged])


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "pictures")
  args = parser.parse_args()
  args.out.mkdir(parents=True, exist_ok=True)
  for picture, tasks in PICTURES.items():
    rows = []
    for task, make, lines, channels in tasks:
      seen = look(make, lines * WORLDS)
      for name, where in channels:
        for line in range(lines):
          images = seen[line * WORLDS : (line + 1) * WORLDS, where]
          rows.append(row(colored(images, name), f"{task}: {name}"))
    path = args.out / f"{picture}.png"
    Image.fromarray(np.concatenate(rows)).save(path, optimize=True)
    print(path)


if __name__ == "__main__":
  main()
