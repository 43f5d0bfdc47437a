"""Count successes of the shipped `lift-rgb` in the loopback: `MUJOCO_GL=egl uv run python tools/count_lifts.py`.

Each episode runs twice, from the same start to the same goal: with images of MuJoCo's own renderer (OpenGL), and with
those of the training's renderer. The difference is the cost of OpenGL's colors. Success is that of the evaluation: the
cube stays within `TOLERANCE` of the goal for `HOLD`.
"""

import argparse
from importlib.resources import as_file
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab.demos import TASKS, shipped
from mjlab.environments import standard_env
from mjlab.registry import load_task
from mjlab_deploy import Bundle, open_bundle
from mjlab_deploy.simulation.loopback import RATE
from mjlab_deploy.simulation.simulated_run import SimulatedRun
from mjlab_manipulation.lift import COMMAND, HOLD, TOLERANCE

NAME, SECONDS, STAND, HALF_CUBE = "lift-rgb", 10.0, 1.0, 0.02
IMAGE = "camera/wrist_camera/rgb"


class TrainingImages:
  """Cameras of the training, in place of those of a loopback robot."""

  def __init__(self, env: Any, cameras: Any) -> None:
    self._env, self._opengl, self.inputs = env, cameras, cameras.inputs
    manager = env.observation_manager
    terms = [(group, row.name) for group in manager.active_terms for row in manager.layout(group)]
    readings = [reading for group, name in terms for reading in manager.source(group, name).readings]
    self._reading = next(reading for reading in readings if reading.name == IMAGE)
    self.differences: list[float] = []
    """Mean difference of each image from that of OpenGL."""

  def draw(self, data: mujoco.MjData) -> dict[str, np.ndarray]:
    sim = self._env.sim
    sim.data.qpos[0] = torch.from_numpy(data.qpos)
    sim.forward()
    sim.expire()
    image = self._reading.read()[0].cpu().numpy()
    self.differences.append(float(np.abs(image - self._opengl.draw(data)[IMAGE]).mean()))
    return {IMAGE: image}


def episode(bundle: Bundle, start: np.ndarray, goal: np.ndarray, env: Any = None) -> tuple[bool, float, float]:
  """Return success, the greatest height of the cube [m], and the mean difference of images.

  Args:
    bundle: The policy.
    start: Pose of the cube, (7,).
    goal: Goal of the cube, (3,) [m].
    env: Environment that draws the images; None: OpenGL draws them.
  """
  run = SimulatedRun(bundle, command=goal.tolist())
  robot: Any = run.robot
  images = None if env is None else TrainingImages(env, robot._cameras)
  robot._cameras = images or robot._cameras
  cube = robot.data.joint("cube/cube")
  cube.qpos[:] = start
  held, highest, needed = 0, 0.0, round(HOLD * RATE)
  while held < needed and robot.time < STAND + SECONDS and run.runner.reason in ("", "not started"):
    run.advance()
    highest = max(highest, float(cube.qpos[2]))
    held = held + 1 if np.linalg.norm(cube.qpos[:3] - goal) < TOLERANCE else 0
  return held >= needed, highest, float(np.mean(images.differences)) if images else 0.0


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--episodes", type=int, default=30)
  episodes = parser.parse_args().episodes
  task = load_task(TASKS[NAME])
  cfg = task.play(task.env) if task.play is not None else task.env
  cfg.scene.num_envs = 1
  command: Any = cfg.commands[COMMAND]
  rng = np.random.default_rng(0)
  counts, heights, away = np.zeros(2, int), np.zeros(2, int), []
  with standard_env(cfg, device="cpu") as env, as_file(shipped()[NAME]) as folder, open_bundle(folder) as bundle:
    env.reset(seed=0)
    for number in range(episodes):
      goal = np.array([rng.uniform(*getattr(command.goal, axis)) for axis in "xyz"])
      yaw = rng.uniform(*command.start_yaw) / 2.0
      x, y = rng.uniform(*command.start.x), rng.uniform(*command.start.y)
      start = np.array([x, y, HALF_CUBE, np.cos(yaw), 0.0, 0.0, np.sin(yaw)])
      results = [episode(bundle, start, goal), episode(bundle, start, goal, env)]
      counts += [result[0] for result in results]
      heights += [result[1] > 0.1 for result in results]
      away.append(results[1][2])
      shown = "; ".join(f"{'success' if held else 'failure'}, up to {height:.2f} m" for held, height, _ in results)
      print(f"{number}: OpenGL {shown.replace('; ', '; training ')}", flush=True)
  for name, held, lifted in zip(("OpenGL", "training"), counts, heights, strict=True):
    print(f"images of {name}: {held} of {episodes} successes, {lifted} lifted by 0.08 m")
  print(f"mean difference of the images: {np.mean(away):.4f} of 1")


if __name__ == "__main__":
  main()
