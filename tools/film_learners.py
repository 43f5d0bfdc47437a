r"""Film of several learners' policies beside one another, under the same commands.

  MUJOCO_GL=egl python tools/film_learners.py Mjlab-Velocity-Flat-Unitree-Go1 "PPO=RUN_A/model_425.pt" \
    "FastSAC=RUN_B/model_130.pt" --output docs/pictures/films/learners_go1.webp

The robots start alike, walk forwards and then turn, as those of `films.py` do. Needs OpenGL, no GPU.
"""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

from films import camera_of, frames, write
from mjlab import load_task
from mjlab_rl import CheckpointPolicy, load_run
from PIL import Image, ImageDraw, ImageFont


def policy_of(env: Any, checkpoint: Path) -> CheckpointPolicy:
  """Return the policy of a checkpoint, of any learner."""
  policy = CheckpointPolicy(env, load_run(checkpoint).agent)
  policy.load(checkpoint)
  return policy


def beside(pictures: tuple[Image.Image, ...], names: list[str]) -> Image.Image:
  """Return pictures beside one another, each with its name."""
  width, height = pictures[0].size
  whole = Image.new("RGB", (width * len(pictures), height))
  draw = ImageDraw.Draw(whole)
  for number, (picture, name) in enumerate(zip(pictures, names, strict=True)):
    whole.paste(picture, (number * width, 0))
    draw.text((number * width + 10, 8), name, fill=(30, 30, 30), font=ImageFont.load_default(20))
  return whole


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task")
  parser.add_argument("policies", nargs="+", metavar="NAME=CHECKPOINT")
  parser.add_argument("--size", type=int, nargs=2, default=(360, 270), metavar=("WIDTH", "HEIGHT"), help="of each")
  parser.add_argument("--rate", type=float, default=25.0, help="frames per second; a divisor of 50")
  parser.add_argument("--quality", type=int, default=60, help="of WebP, from 0 to 100; lower if the film exceeds 1 MB")
  parser.add_argument("--distance", type=float, help="distance of the camera [m]")
  parser.add_argument("--output", type=Path, required=True)
  args = parser.parse_args()
  camera = camera_of(args.task.lower())
  if args.distance is not None:
    camera = dataclasses.replace(camera, distance=args.distance)
  names, films = [], []
  for words in args.policies:
    name, _, file = words.partition("=")

    def loaded(env: Any, file: str = file) -> CheckpointPolicy:
      return policy_of(env, Path(file))

    names.append(name)
    films.append(frames(load_task(args.task), loaded, camera, tuple(args.size), args.rate, 0.0))
  pictures = [beside(moment, names) for moment in zip(*films, strict=True)]
  args.output.parent.mkdir(parents=True, exist_ok=True)
  write(args.output, pictures, args.rate, args.quality)


if __name__ == "__main__":
  main()
