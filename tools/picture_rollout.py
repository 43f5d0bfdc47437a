"""Frame strips of policies at work: `uv run python tools/picture_rollout.py RUN [RUN ...] --output FILE.png`.

A row for each run or checkpoint, frames from left to right in time, as the task is played: without noise and
randomisation. Below the frames of a policy that sees, what it sees. Needs OpenGL, no GPU.
"""

import argparse
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import torch
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import CheckpointPolicy, checkpoints, load_run
from mjlab_viewer import CameraCfg, OffscreenRenderer, PictureCfg, SnapshotTaker
from PIL import Image, ImageDraw, ImageFont

TITLE, GAP, SEEN = 22, 2, 96


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("runs", nargs="+", type=Path, help="run directories or checkpoints")
  parser.add_argument("--frames", type=int, default=6)
  parser.add_argument("--start", type=float, default=0.0, help="time of the first frame [s]")
  parser.add_argument("--seconds", type=float, default=4.0, help="from the first frame to the last")
  parser.add_argument("--size", type=int, nargs=2, default=(256, 192), metavar=("WIDTH", "HEIGHT"))
  parser.add_argument("--seed", type=int, default=0)
  parser.add_argument("--distance", type=float, help="of the eye from what it looks at [m]")
  parser.add_argument("--lookat", type=float, nargs=3, metavar=("X", "Y", "Z"), help="a fixed point; else the robot")
  parser.add_argument("--azimuth", type=float, default=120.0, help="[deg]")
  parser.add_argument("--elevation", type=float, default=-20.0, help="[deg]")
  parser.add_argument("--output", type=Path, required=True)
  args = parser.parse_args()
  rows = [strip(run, args) for run in args.runs]
  width = max(row.width for row in rows)
  sheet = Image.new("RGB", (width, sum(row.height for row in rows)), "white")
  top = 0
  for row in rows:
    sheet.paste(row, (0, top))
    top += row.height
  args.output.parent.mkdir(parents=True, exist_ok=True)
  sheet.save(args.output, optimize=True)
  print(f"wrote {args.output}")


def strip(run: Path, args: argparse.Namespace) -> Image.Image:
  """Join the frames of one policy side by side, under its task's name."""
  checkpoint = run if run.is_file() else checkpoints(run)[-1]
  manifest = load_run(checkpoint)
  play = load_task(manifest.task).play
  cfg = play(manifest.env) if play is not None else manifest.env
  cfg.scene.num_envs, cfg.seed = 1, args.seed
  width, height = args.size
  lookat = None if args.lookat is None else tuple(args.lookat)
  camera = CameraCfg(distance=args.distance, azimuth=args.azimuth, elevation=args.elevation, lookat=lookat)
  frames, seen = [], []
  with ManagerBasedRlEnv(cfg, device="cpu") as env, ExitStack() as stack:
    policy = CheckpointPolicy(env, manifest.agent)
    policy.load(checkpoint)
    picture = PictureCfg(width=width, height=height, camera=camera)
    renderer = stack.enter_context(OffscreenRenderer(env.sim.mj_model, picture))
    taker = SnapshotTaker(env)
    observations, _ = env.reset(seed=args.seed)
    times = np.linspace(args.start, args.start + args.seconds, args.frames)
    wanted = [round(float(time) / env.step_dt) for time in times]
    for step in range(wanted[-1] + 1):
      if step in wanted:
        frames.append(renderer.render(taker.take((0,), drawers=env.default_drawers())))
        if "camera" in observations:
          seen.append(torch.as_tensor(observations["camera"])[0].cpu().numpy())
      with torch.no_grad():
        observations, _, terminated, truncated, _ = env.step(policy(observations))
      policy.reset(terminated | truncated)
  below = SEEN + GAP if seen else 0
  image = Image.new("RGB", (len(frames) * (width + GAP) - GAP, TITLE + height + below + GAP), "white")
  draw = ImageDraw.Draw(image)
  iterations = checkpoint.stem.removeprefix("model_")
  title = f"{manifest.task}, {iterations} iterations, {args.seconds:g} s"
  draw.text((2, 3), title, fill="black", font=ImageFont.load_default(size=13))
  for k, frame in enumerate(frames):
    left = k * (width + GAP)
    image.paste(Image.fromarray(frame), (left, TITLE))
    if seen:
      channels = seen[k][:3] if len(seen[k]) >= 3 else seen[k][:1].repeat(3, 0)
      pixels = (255 * channels.clip(0.0, 1.0)).astype(np.uint8).transpose(1, 2, 0)
      shown = Image.fromarray(pixels).resize((SEEN, SEEN), Image.Resampling.NEAREST)
      image.paste(shown, (left + (width - SEEN) // 2, TITLE + height + GAP))
  return image


if __name__ == "__main__":
  main()
