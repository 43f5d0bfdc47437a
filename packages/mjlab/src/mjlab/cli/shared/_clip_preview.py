"""Clips in a viewer or a film: a robot takes one pose after another, without physics."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mjlab_viewer
import mujoco
import numpy as np
import torch
from mjlab_motions import Kinematics, Motion
from mjlab_scene import EntityCfg, Scene, SceneCfg
from mjlab_terrain import PlaneCfg

MOST_FRAMES = 30
"""Limit of the frames per second of a film; of faster clips every n-th frame is shown [Hz]."""


def preview_model(robot: mujoco.MjSpec) -> mujoco.MjModel:
  """Return a scene with a robot, on flat ground unless its model contains a plane."""
  has_ground = any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in robot.worldbody.geoms)
  entity = EntityCfg(spec_fn=robot.copy)
  return Scene(SceneCfg(terrain=None if has_ground else PlaneCfg(), entities={"robot": entity})).spec.compile()


def clip_replay(model: mujoco.MjModel, motion: Motion) -> "mjlab_viewer.Replay":
  """Return a clip as an environment that viewers play, with one world of `preview_model`."""
  robot = Kinematics(model, "robot/")
  qpos = np.tile(model.qpos0, (motion.num_frames, 1))
  root = int(model.jnt_qposadr[model.body_jntadr[model.body(f"robot/{robot.root_body}").id]])
  qpos[:, root : root + 7] = torch.cat((motion.root_pos, motion.root_quat), 1)
  # A motion that was read for this robot has its joints, in its order.
  qpos[:, model.jnt_qposadr[robot.joint_ids]] = motion.joint_pos
  moments = {"qpos": qpos[:, None], "time": np.arange(motion.num_frames)[:, None] / motion.rate}
  return mjlab_viewer.Replay(model, moments, 1.0 / motion.rate, moment=f"clip {motion.name}, frame")


def film_clip(
  replay: "mjlab_viewer.Replay", rate: float, path: Path, renderer: Any, show: Callable[[float], None]
) -> None:
  """Film a clip of `rate` frames per second in real time, and call `show` with the share that is done."""
  every = math.ceil(rate / MOST_FRAMES)
  replay.film(path, renderer, every=every, on_frame=lambda frame: show(min(1.0, frame * every / replay.num_steps)))
