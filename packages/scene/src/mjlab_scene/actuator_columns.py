"""An entity's set-points and measurements as its actuators want them: one column per target."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np
import torch
from mjlab_actuators import ActuatorSet
from mjlab_core.masking import fill_, where_

from mjlab_scene.entity_data import EntityData
from mjlab_scene.indexing import EntityIndexing, Index, as_index, select
from mjlab_scene.initial_state import InitialState

if TYPE_CHECKING:
  from mjlab_sim import Simulation


class ActuatorColumns:
  """Builds the actuators of an entity and gathers what they read: its joints, then the tendons and sites they drive.

  Of ball joints, which actuators do not know, the columns are left out.
  """

  def __init__(
    self,
    actuators: ActuatorSet,
    sim: Simulation,
    indexing: EntityIndexing,
    data: EntityData,
    initial: InitialState,
    *,
    prefix: str,
    rng: torch.Generator | None,
  ) -> None:
    self._actuators, self._sim, self._ix, self._data = actuators, sim, indexing, data
    names = indexing.names
    scalar = [joint for joint, columns in enumerate(indexing.q_of_joint) if len(columns) == 1]
    actuators.build(
      sim.mj_model,
      target_names=[names["joint"][joint] for joint in scalar],
      num_envs=sim.num_envs,
      device=sim.device,
      dtype=sim.dtype,
      generator=rng,
      prefix=prefix,
      ctrl=sim.data.ctrl,
    )
    self._joints: tuple[Index, Index] | None = None
    if not indexing.scalar_joints:
      q, v = (
        as_index([of[joint][0] for joint in scalar], sim.device) for of in (indexing.q_of_joint, indexing.v_of_joint)
      )
      self._joints = (q, v)

    def places(kind: str, driven: tuple[str, ...]) -> Index:
      return as_index([names[kind].index(name) for name in driven], sim.device)

    self._drives_others = len(actuators.targets) > len(scalar)
    self._tendons = places("tendon", actuators.driven("tendon"))
    self._sites = places("site", actuators.driven("site"))
    self._site_outputs = as_index(actuators.site_outputs, sim.device)
    self.follows_set_points_only = not actuators.needs_feedback and all(law.delay is None for law in actuators.groups)
    """Whether the same set-points always give the same controls."""
    self._default_tendon_len, self._default_site_pos = self._lengths(initial)

  def compute(self) -> None:
    """Controls of this substep; to be called exactly once for each."""
    set_points = self._set_points()
    measured = set_points[:2] if self.follows_set_points_only else self._measurements()
    self._actuators.compute(*set_points, *measured)

  def reset(self, mask: torch.Tensor) -> None:
    """Set-points of masked worlds (num_envs,) to where the entity starts, at rest, as if they had always been that."""
    data = self._data
    if self._drives_others:
      where_(data.tendon_len_target, mask, self._default_tendon_len)
      where_(data.site_pos_target, mask, self._default_site_pos)
      for at_rest in (
        data.tendon_vel_target,
        data.tendon_effort_target,
        data.site_vel_target,
        data.site_effort_target,
      ):
        fill_(at_rest, mask, 0.0)
    self._actuators.reset(mask, *self._set_points())

  @property
  def version(self) -> int:
    """A number that changes whenever a set-point is written."""
    data = self._data
    version = data.joint_pos_target._version + data.joint_vel_target._version + data.joint_effort_target._version
    if self._drives_others:
      version += data.tendon_len_target._version + data.tendon_vel_target._version + data.tendon_effort_target._version
      version += data.site_pos_target._version + data.site_vel_target._version + data.site_effort_target._version
    return version

  def _set_points(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    data = self._data
    position, velocity, effort = data.joint_pos_target, data.joint_vel_target, data.joint_effort_target
    if self._joints is not None:
      q, v = self._joints
      position, velocity, effort = select(position, q), select(velocity, v), select(effort, v)
    if self._drives_others:
      position = self._beside(position, data.tendon_len_target, data.site_pos_target)
      velocity = self._beside(velocity, data.tendon_vel_target, data.site_vel_target)
      effort = self._beside(effort, data.tendon_effort_target, data.site_effort_target)
    return position, velocity, effort

  def _measurements(self) -> tuple[torch.Tensor, torch.Tensor]:
    data, engine = self._data, self._sim.data
    position, velocity = data.joint_pos, data.joint_vel
    if self._joints is not None:
      position, velocity = select(position, self._joints[0]), select(velocity, self._joints[1])
    if not self._drives_others:
      return position, velocity
    length, rate = data.tendon_len, data.tendon_vel
    outputs = self._site_outputs
    return (
      torch.cat((position, select(length, self._tendons), select(engine.actuator_length, outputs)), dim=1),
      torch.cat((velocity, select(rate, self._tendons), select(engine.actuator_velocity, outputs)), dim=1),
    )

  def _beside(self, joints: torch.Tensor, tendons: torch.Tensor, sites: torch.Tensor) -> torch.Tensor:
    return torch.cat((joints, select(tendons, self._tendons), select(sites, self._sites)), dim=1)

  def _lengths(self, initial: InitialState) -> tuple[torch.Tensor, torch.Tensor]:
    """Lengths of the tendons (1, num_tendons), and positions of the driven sites (1, num_sites), at the start."""
    model, ix, names = self._sim.mj_model, self._ix, self._ix.names
    lengths, positions = np.zeros(len(names["tendon"])), np.zeros(len(names["site"]))
    if self._drives_others:
      start = mujoco.MjData(model)
      if ix.root_q is not None:
        start.qpos[ix.root_q] = initial.root_pose
      for joint, name in zip(ix.ids["joint"], names["joint"], strict=True):
        adr = int(model.jnt_qposadr[joint])
        start.qpos[adr : adr + initial.joint_pos[name].size] = initial.joint_pos[name]
      for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon, mujoco.mj_transmission):
        stage(model, start)
      lengths = start.ten_length[ix.ids["tendon"]]
      for name, output in zip(self._actuators.driven("site"), self._actuators.site_outputs, strict=True):
        positions[names["site"].index(name)] = start.actuator_length[output]
    length, position = (torch.as_tensor(row[None], dtype=self._sim.dtype) for row in (lengths, positions))
    return length.to(self._sim.device), position.to(self._sim.device)
