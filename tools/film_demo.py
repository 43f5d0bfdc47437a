"""Films the walking policy that ships, for the root README: `MUJOCO_GL=egl uv run python tools/film_demo.py`.

Writes an animated WebP of one Unitree Go1 that follows velocity commands. With MENAGERIE_ROOT, or with meshes in the
cache of mujoco-menagerie, the robot has its real shape; otherwise it is drawn from primitives. Needs OpenGL, no GPU.
"""

import argparse
from pathlib import Path

import torch
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import CheckpointPolicy, checkpoints
from mjlab_viewer import CameraCfg, OffscreenRenderer, PictureCfg, SnapshotTaker
from PIL import Image

ROOT = Path(__file__).parents[1]
POLICY = ROOT / "packages/mjlab/src/mjlab/demo_policy"
# Forward speed, sideways speed and turning rate [m/s, m/s, rad/s], each for as many seconds.
COMMANDS = (((0.8, 0.0, 0.0), 1.5), ((0.7, 0.0, 0.5), 1.5))
SETTLE = 1.0


def frames(size: tuple[int, int], rate: float) -> list[Image.Image]:
  """Return the frames of the film."""
  task = load_task("Mjlab-Velocity-Flat-Unitree-Go1")
  cfg = task.env if task.play is None else task.play(task.env)
  cfg.scene.num_envs, cfg.seed = 1, 0
  camera = CameraCfg(distance=1.6, azimuth=130.0, elevation=-14.0)
  picture = PictureCfg(width=size[0], height=size[1], camera=camera)
  found = []
  with ManagerBasedRlEnv(cfg, device="cpu") as env, OffscreenRenderer(env.sim.mj_model, picture) as renderer:
    policy = CheckpointPolicy(env, task.agent, task.runner)
    policy.load(checkpoints(POLICY)[-1])
    taker = SnapshotTaker(env)
    observations, _ = env.reset(seed=0)
    every = max(1, round(1.0 / (rate * env.step_dt)))
    plan = [(COMMANDS[0][0], SETTLE), *COMMANDS]
    commands = [command for command, seconds in plan for _ in range(round(seconds / env.step_dt))]
    for step, command in enumerate(commands):
      env.steering()["twist"].steer(0, command)
      if step >= SETTLE / env.step_dt and step % every == 0:
        found.append(Image.fromarray(renderer.render(taker.take((0,)))))
      with torch.no_grad():
        observations, _, _, _, _ = env.step(policy(observations))
  return found


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--size", type=int, nargs=2, default=(480, 270), metavar=("WIDTH", "HEIGHT"))
  parser.add_argument("--rate", type=float, default=25.0, help="frames per second; a divisor of 50")
  parser.add_argument("--quality", type=int, default=60, help="of WebP, from 0 to 100")
  parser.add_argument("--output", type=Path, default=ROOT / "docs/pictures/go1_walk.webp")
  arguments = parser.parse_args()
  first, *others = frames(tuple(arguments.size), arguments.rate)
  duration = round(1000 / arguments.rate)
  first.save(
    arguments.output,
    save_all=True,
    append_images=others,
    duration=duration,
    loop=0,
    quality=arguments.quality,
    method=4,
  )
  print(f"wrote {arguments.output}: {len(others) + 1} frames, {arguments.output.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
  main()
