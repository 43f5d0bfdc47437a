"""Clips in a viewer or a film: a robot takes one pose after another, without physics."""

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import torch
from mjlab_motions import Kinematics, Motion
from mjlab_scene import EntityCfg, Scene, SceneCfg
from mjlab_terrain import PlaneCfg

if TYPE_CHECKING:
  from mjlab_viewer import OffscreenRenderer, Replay

MOST_FRAMES = 30
"""Limit of the frames per second of a film; of faster clips every n-th frame is shown [Hz]."""


class Preview:
  """Scene with a robot, on flat ground unless its model contains a plane.

  Args:
    spec: The robot.
  """

  def __init__(self, spec: mujoco.MjSpec) -> None:
    self._spec = spec

  @functools.cached_property
  def model(self) -> mujoco.MjModel:
    """The scene, compiled when it is read first."""
    has_ground = any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in self._spec.worldbody.geoms)
    terrain, robot = None if has_ground else PlaneCfg(), EntityCfg(spec_fn=self._spec.copy)
    return Scene(SceneCfg(terrain=terrain, entities={"robot": robot})).spec.compile()

  def replay(self, motion: Motion) -> "Replay":
    """Return the clip as an environment that viewers play, with one world."""
    from mjlab_viewer import Replay

    model, robot = self.model, Kinematics(self.model, "robot/")
    qpos = np.tile(model.qpos0, (motion.num_frames, 1))
    root = int(model.jnt_qposadr[model.body_jntadr[model.body(f"robot/{robot.root_body}").id]])
    qpos[:, root : root + 7] = torch.cat((motion.root_pos, motion.root_quat), 1)
    # A motion that was read for this robot has its joints, in its order.
    qpos[:, model.jnt_qposadr[robot.joint_ids]] = motion.joint_pos
    time = np.arange(motion.num_frames)[:, None] / motion.rate
    moments = {"qpos": qpos[:, None], "time": time}
    return Replay(model, moments, 1.0 / motion.rate, moment=f"clip {motion.name}, frame")

  def film(self, motion: Motion, path: Path, renderer: "OffscreenRenderer", show: Callable[[float], None]) -> None:
    """Film a clip in real time, and call `show` with the share that is done."""
    every = math.ceil(motion.rate / MOST_FRAMES)
    frames = len(range(0, motion.num_frames, every))
    self.replay(motion).film(path, renderer, every=every, on_frame=lambda frame: show(frame / frames))
