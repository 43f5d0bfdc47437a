"""Draws what the policies that lift see, for the documentation: `uv run python tools/picture_manipulation.py`.

A row for each channel of each task that sees, a column for each world, as they begin: 32 x 32 pixels, enlarged. It
needs neither a GPU nor OpenGL.
"""

import argparse
from pathlib import Path

import mjlab
import numpy as np
import torch
from mjlab.making import make
from PIL import Image, ImageDraw, ImageFont

WORLDS = 6
ENLARGED = 5
TITLE = 26
TASKS = {
  "Mjlab-Lift-Cube-Yam-Depth": (("depth", slice(0, 1)),),
  "Mjlab-Lift-Cube-Yam-Rgb": (("colours", slice(0, 3)),),
  "Mjlab-Multi-Cube-Seg-Yam": (("depth", slice(0, 1)), ("mask of the cube that is meant", slice(1, 2))),
}


def row(images: np.ndarray, title: str) -> np.ndarray:
  """Images (n, 1 or 3, h, w) in [0, 1] beside one another, under a title."""
  pixels = np.broadcast_to(images, (len(images), 3, *images.shape[2:])).transpose(0, 2, 3, 1)
  pixels = np.pad(pixels, ((0, 0), (0, 0), (0, 1), (0, 0)), constant_values=1.0)
  beside = (np.concatenate(list(pixels), axis=1) * 255).astype(np.uint8)
  enlarged = beside.repeat(ENLARGED, 0).repeat(ENLARGED, 1)
  paper = Image.new("RGB", (enlarged.shape[1], TITLE), (255, 255, 255))
  ImageDraw.Draw(paper).text((4, 5), title, fill=(45, 52, 60), font=ImageFont.load_default(15))
  return np.concatenate([np.asarray(paper), enlarged])


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "pictures" / "manipulation.png")
  args = parser.parse_args()
  rows = []
  for task, channels in TASKS.items():
    assert task in mjlab.list_tasks()
    with make(task, num_envs=WORLDS, device="cpu") as env:
      observations, _ = env.reset(seed=3)
      images = torch.as_tensor(observations["camera"]).numpy()
    rows += [row(images[:, where], f"{task}: {name}") for name, where in channels]
  args.out.parent.mkdir(parents=True, exist_ok=True)
  Image.fromarray(np.concatenate(rows)).save(args.out, optimize=True)
  print(args.out)


if __name__ == "__main__":
  main()
