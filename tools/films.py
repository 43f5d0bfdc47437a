"""Films of the policies that ship, for site and README: `MUJOCO_GL=egl uv run python tools/films.py [NAME ...]`.

Writes docs/pictures/films/NAME.webp, an animation of one robot, for each policy of `mjlab.demos`. Robots that take
velocity commands walk forwards and then turn. With MENAGERIE_ROOT, or with meshes in the cache of mujoco-menagerie,
robots have their real shape; otherwise they are drawn from primitives. Needs OpenGL, no GPU.
"""

import argparse
import dataclasses
import functools
from collections.abc import Callable
from importlib.resources import as_file
from io import BytesIO
from pathlib import Path
from typing import Any

import torch
from mjlab import load_task
from mjlab.demos import shipped
from mjlab.environments import standard_env
from mjlab_rl import BundlePolicy, TaskCfg
from mjlab_rl.bundles.bundle_policy import task_of_bundle
from mjlab_viewer import CameraCfg, OffscreenRenderer, PictureCfg, SnapshotTaker
from PIL import Image

FOLDER = Path(__file__).parents[1] / "docs" / "pictures" / "films"
# Forward speed, sideways speed and turning rate [m/s, m/s, rad/s], each for as many seconds.
COMMANDS = (((0.8, 0.0, 0.0), 1.5), ((0.7, 0.0, 0.5), 1.5))
SETTLE = 1.0  # seconds of walking before the film
CAMERAS = {
  "lift": CameraCfg(lookat=(0.25, 0.0, 0.2), distance=1.2, azimuth=140.0, elevation=-18.0),
  "rough": CameraCfg(distance=2.6, azimuth=130.0, elevation=-20.0),
  "g1": CameraCfg(distance=2.4, azimuth=130.0, elevation=-10.0),
  "track": CameraCfg(distance=2.4, azimuth=130.0, elevation=-10.0),
  "go1": CameraCfg(distance=1.6, azimuth=130.0, elevation=-14.0),
}
MOST_BYTES = 1_000_000


def camera_of(name: str) -> CameraCfg:
  """Return the camera of a policy: the first whose key is part of the name."""
  return next((camera for key, camera in CAMERAS.items() if key in name), CameraCfg())


def frames(
  task: TaskCfg[Any],
  policy_of: Callable[[Any], Any],
  camera: CameraCfg,
  size: tuple[int, int],
  rate: float,
  seconds: float,
) -> list[Image.Image]:
  """Return the frames of a film of a policy, which `policy_of` makes for an environment."""
  cfg: Any = task.env if task.play is None else task.play(task.env)
  cfg.scene.num_envs, cfg.seed = 1, 0
  picture = PictureCfg(width=size[0], height=size[1], camera=camera)
  found = []
  with standard_env(cfg, device="cpu") as env, OffscreenRenderer(env.sim.mj_model, picture) as renderer:
    policy = policy_of(env)
    taker = SnapshotTaker(env)
    observations, _ = env.reset(seed=0)
    every = max(1, round(1.0 / (rate * env.step_dt)))
    walks = "twist" in env.steering()
    settle = SETTLE if walks else 0.0
    if walks:
      plan = [(COMMANDS[0][0], SETTLE), *COMMANDS]
      commands: list[Any] = [command for command, seconds in plan for _ in range(round(seconds / env.step_dt))]
    else:
      commands = [None] * round(seconds / env.step_dt)
    for step, command in enumerate(commands):
      if command is not None:
        env.steering()["twist"].steer(0, command)
      if step >= settle / env.step_dt and step % every == 0:
        drawers = () if walks else env.default_drawers()
        found.append(Image.fromarray(renderer.render(taker.take((0,), drawers=drawers))))
      with torch.no_grad():
        observations, _, terminated, truncated, _ = env.step(policy(observations))
      policy.reset(terminated | truncated)
  return found


def webp(pictures: list[Image.Image], rate: float, quality: int) -> bytes:
  """Return an animation that repeats."""
  first, *others = pictures
  file, duration = BytesIO(), round(1000 / rate)
  first.save(file, "webp", save_all=True, append_images=others, duration=duration, loop=0, quality=quality, method=4)
  return file.getvalue()


def write(path: Path, pictures: list[Image.Image], rate: float, quality: int) -> None:
  """Write an animation of at most 1 MB."""
  while len(data := webp(pictures, rate, quality)) > MOST_BYTES and quality > 10:
    quality -= 10
  path.write_bytes(data)
  print(f"wrote {path}: {len(pictures)} frames, {len(data) / 1000:.0f} kB, quality {quality}")


def main() -> None:
  policies = shipped()
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("names", nargs="*", help=f"policies to film, all of {', '.join(policies)} unless given")
  parser.add_argument("--size", type=int, nargs=2, default=(480, 270), metavar=("WIDTH", "HEIGHT"))
  parser.add_argument("--rate", type=float, default=25.0, help="frames per second; a divisor of 50")
  parser.add_argument("--seconds", type=float, default=4.0, help="length where no velocity is commanded")
  parser.add_argument("--quality", type=int, default=60, help="of WebP, from 0 to 100; lower if a film exceeds 1 MB")
  parser.add_argument("--distance", type=float, help="distance of the camera [m]")
  args = parser.parse_args()
  if unknown := set(args.names) - set(policies):
    parser.error(f"{', '.join(sorted(unknown))}: not shipped; there are {', '.join(policies)}")
  FOLDER.mkdir(parents=True, exist_ok=True)
  for name in args.names or policies:
    camera = camera_of(name)
    if args.distance is not None:
      camera = dataclasses.replace(camera, distance=args.distance)
    with as_file(policies[name]) as folder:
      task = load_task(task_of_bundle(folder))
      policy_of = functools.partial(BundlePolicy, folder)
      pictures = frames(task, policy_of, camera, tuple(args.size), args.rate, args.seconds)
    write(FOLDER / f"{name}.webp", pictures, args.rate, args.quality)


if __name__ == "__main__":
  main()
