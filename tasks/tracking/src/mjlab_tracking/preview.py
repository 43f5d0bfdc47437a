"""Looking at clips: a robot is put into one pose after another, without physics. Needs the package mjlab-viewer."""

import math
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import torch
from mjlab_scene import EntityCfg, Scene, SceneCfg
from mjlab_terrain import PlaneCfg

from mjlab_tracking.kinematics import Kinematics
from mjlab_tracking.motion import Motion, MotionError

if TYPE_CHECKING:
  from mjlab_viewer import OffscreenRenderer, Replay

MOST_FRAMES = 30
"""Frames of a film per second, at most; of a faster clip every other is left out, and so on [Hz]."""


class Preview:
  """A robot in the scene that the viewers show, on flat ground unless its model has ground of its own.

  Args:
    spec: The robot.

  Raises:
    MotionError: mjlab-viewer is not installed.
  """

  def __init__(self, spec: mujoco.MjSpec) -> None:
    try:
      import mjlab_viewer  # noqa: F401
    except ImportError as error:
      raise MotionError(
        f"clips are shown by the package mjlab-viewer ({error}): uv pip install mjlab-viewer"
      ) from error
    has_ground = any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.worldbody.geoms)
    robot = EntityCfg(spec_fn=spec.copy)
    self.model = Scene(SceneCfg(terrain=None if has_ground else PlaneCfg(), entities={"robot": robot})).spec.compile()
    self._kinematics = Kinematics(self.model, "robot/")

  def replay(self, motion: Motion) -> "Replay":
    """The clip as an environment that viewers play, in one world."""
    from mjlab_viewer import Replay

    model, robot = self.model, self._kinematics
    qpos = np.tile(model.qpos0, (motion.num_frames, 1))
    root = int(model.jnt_qposadr[model.body_jntadr[model.body(f"robot/{robot.root_body}").id]])
    qpos[:, root : root + 7] = torch.cat((motion.root_pos, motion.root_quat), 1)
    # A motion that was read for this robot has its joints, in its order.
    qpos[:, model.jnt_qposadr[robot.joint_ids]] = motion.joint_pos
    time = np.arange(motion.num_frames)[:, None] / motion.rate
    return Replay(model, {"qpos": qpos[:, None], "time": time}, 1.0 / motion.rate)

  @contextmanager
  def renderer(self) -> Generator["OffscreenRenderer"]:
    """What makes the pictures of films.

    Raises:
      MotionError: OpenGL does not work here.
    """
    from mjlab_viewer import OffscreenRenderer, RenderingError

    try:
      renderer = OffscreenRenderer(self.model)
    except RenderingError as error:
      raise MotionError(str(error)) from error
    with renderer:
      yield renderer

  def film(self, motion: Motion, path: Path, renderer: "OffscreenRenderer") -> None:
    """Film a clip in real time; says how far it is where somebody looks on."""
    every = math.ceil(motion.rate / MOST_FRAMES)
    frames = len(range(0, motion.num_frames, every))

    def show(frame: int) -> None:
      if sys.stderr.isatty():
        end = "\n" if frame == frames else ""
        print(f"\rfilming {motion.name}: {frame} of {frames} frames", end=end, file=sys.stderr, flush=True)

    self.replay(motion).film(path, renderer, every=every, on_frame=show)

  def browse(self, motion: Motion, *, host: str, port: int) -> None:
    """Play a clip in a browser, again and again, until Ctrl-C.

    Raises:
      MotionError: it cannot listen there.
    """
    from mjlab_viewer import BrowserViewer, Playback, ViewerError, ZeroPolicy

    replay = self.replay(motion)
    playback = Playback(replay, ZeroPolicy(1, 0, replay.sim.device))
    try:
      viewer = BrowserViewer(replay, playback=playback, host=host, port=port, label=motion.name)
    except ViewerError as error:
      raise MotionError(str(error)) from error
    with viewer:
      print(f"open {viewer.url} (Ctrl-C ends)", flush=True)
      try:
        viewer.run()
      except KeyboardInterrupt:
        print()
