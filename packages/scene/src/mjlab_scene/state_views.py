"""An entity's state as it lies in the simulation's memory."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from mjlab_scene.indexing import EntityIndexing, Index

if TYPE_CHECKING:
  from mjlab_sim import Simulation


class StateViews:
  """Views of the simulation's state; its memory never moves. None where the layout allows no view."""

  def __init__(self, sim: Simulation, ix: EntityIndexing) -> None:
    def view(array: torch.Tensor, columns: Index) -> torch.Tensor | None:
      return array[:, columns] if isinstance(columns, slice) else None

    self.joint_pos = view(sim.data.qpos, ix.joint_q)
    self.joint_vel = view(sim.data.qvel, ix.joint_v)
    self.root_pose: torch.Tensor | None = None
    self.root_lin_vel_w: torch.Tensor | None = None
    self.root_ang_vel_b: torch.Tensor | None = None
    if ix.root_q is not None and ix.root_v is not None:
      self.root_pose = sim.data.qpos[:, ix.root_q]
      self.root_pos, self.root_quat = self.root_pose[:, :3], self.root_pose[:, 3:]
      velocity = sim.data.qvel[:, ix.root_v]
      self.root_lin_vel_w, self.root_ang_vel_b = velocity[:, :3], velocity[:, 3:]
    else:
      assert ix.mocap is not None
      self.root_pos, self.root_quat = sim.data.mocap_pos[:, ix.mocap], sim.data.mocap_quat[:, ix.mocap]
