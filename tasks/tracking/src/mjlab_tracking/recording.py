"""Turning what a robot does into a clip."""

from typing import TYPE_CHECKING

import torch

from mjlab_tracking.kinematics import Kinematics
from mjlab_tracking.motion import Motion, MotionError

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


class MotionRecorder:
  """Notes the pose of one robot in one world, once a step.

  Args:
    env: The environment.
    entity: Name of the robot; it must have a floating base.
    world: Which world.

  Raises:
    MotionError: There is no such entity or world, or the entity cannot perform motions.
  """

  def __init__(self, env: "ManagerBasedRlEnv", *, entity: str = "robot", world: int = 0) -> None:
    if entity not in env.scene.entities:
      raise MotionError(f"entity '{entity}' does not exist; the scene has: {', '.join(env.scene.entities)}")
    if not 0 <= world < env.num_envs:
      raise MotionError(f"world {world} does not exist; there are 0 to {env.num_envs - 1}")
    self._robot = env.scene[entity]
    self._kinematics = Kinematics(env.sim.mj_model, self._robot.prefix)
    if self._kinematics.joint_names != self._robot.joint_names:
      raise MotionError(f"entity '{entity}' has joints outside of its floating tree")
    self._env, self._world = env, world
    self._rows: list[torch.Tensor] = []

  def note(self) -> None:
    """Takes the present pose as the next frame; reads from the device."""
    data, w = self._robot.data, self._world
    origin = self._env.scene.env_origins[w]
    row = (data.root_link_pos_w[w] - origin, data.root_link_quat_w[w], data.joint_pos[w])
    self._rows.append(torch.cat(row).double().cpu())

  def motion(self, name: str, *, source: str, license: str) -> Motion:
    """The frames so far, at the rate of control, where the world's origin is that of the clip.

    Raises:
      MotionError: There are fewer than three.
    """
    if len(self._rows) < 3:
      raise MotionError(f"recording '{name}': {len(self._rows)} frames are too few, a motion needs three")
    table = torch.stack(self._rows)
    return Motion(
      name=name,
      rate=1.0 / self._env.step_dt,
      root_body=self._kinematics.root_body,
      joint_names=self._kinematics.joint_names,
      root_pos=table[:, :3],
      root_quat=table[:, 3:7],
      joint_pos=table[:, 7:],
      source=source,
      license=license,
      history=("recorded from a simulation",),
    )

  @property
  def kinematics(self) -> Kinematics:
    """The robot as a motion sees it."""
    return self._kinematics
