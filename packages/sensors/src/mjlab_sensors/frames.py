"""Frames of an entity that sensors are attached to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import torch

from mjlab_sensors.native._elements import ElementMatch

if TYPE_CHECKING:
  from mjlab_sim import Simulation

FrameType = Literal["site", "body", "geom", "camera"]

POSES = {
  "site": ("site_xpos", "site_xmat"),
  "xbody": ("xpos", "xmat"),
  "body": ("xipos", "ximat"),
  "geom": ("geom_xpos", "geom_xmat"),
  "camera": ("cam_xpos", "cam_xmat"),
}
"""Fields of the simulation's data with position and axes of an element, by MuJoCo's name of its kind."""

_BODY_OF = {"site": "site_bodyid", "geom": "geom_bodyid", "camera": "cam_bodyid"}

# Least length of the projection of a frame's x axis to the ground that still gives the heading.
_SHORT = 0.1


@dataclass(kw_only=True, frozen=True)
class FrameMatch(ElementMatch):
  """Frames of the scene, by patterns."""

  type: FrameType
  """Kind of element that has the frames. A camera looks along its negative z axis; x points right and y up in its
  image."""


class FrameSet:
  """The frames of a `FrameMatch` in a simulation.

  It reads the simulation's memory. Read `sim.version` before, which makes that memory current.
  """

  def __init__(self, sim: Simulation, frame_type: FrameType, names: tuple[str, ...]) -> None:
    position, rotation = POSES["xbody" if frame_type == "body" else frame_type]
    model = sim.mj_model
    ids = [getattr(model, frame_type)(name).id for name in names]
    bodies = np.arange(model.nbody) if frame_type == "body" else getattr(model, _BODY_OF[frame_type])
    self.body_ids = [int(bodies[index]) for index in ids]
    self._index = torch.tensor(ids, device=sim.device)
    self._all_positions: torch.Tensor = getattr(sim.data, position)[:]
    self._all_rotations: torch.Tensor = getattr(sim.data, rotation)[:]
    # In each row-major matrix: x and y of the x axis, then of the y axis turned back by 90 degrees, up to the sign.
    columns = 9 * self._index[:, None] + torch.tensor((0, 3, 4, 1), device=sim.device)
    self._columns = columns.flatten()
    self._signs = torch.tensor(((1, 1), (1, -1)), dtype=sim.dtype, device=sim.device)

  @property
  def positions(self) -> torch.Tensor:
    """Origins, world frame, (num_envs, num_frames, 3) [m]."""
    return self._all_positions.index_select(1, self._index)

  @property
  def heights(self) -> torch.Tensor:
    """World heights of the origins, (num_envs, num_frames) [m]."""
    return self._all_positions[:, :, 2].index_select(1, self._index)

  @property
  def rotations(self) -> torch.Tensor:
    """Rotation matrices from frame to world, (num_envs, num_frames, 3, 3)."""
    return self._all_rotations.index_select(1, self._index)

  @property
  def headings(self) -> torch.Tensor:
    """Unit heading of the frames on the ground, world frame, (num_envs, num_frames, 2).

    It is the x axis projected to the ground, or the y axis turned back by 90 degrees if x is nearly vertical.
    """
    axes = self._all_rotations.flatten(1).index_select(1, self._columns).unflatten(1, (-1, 2, 2)) * self._signs
    length = torch.linalg.vector_norm(axes, dim=-1, keepdim=True)
    units = axes / length
    return torch.where(length[:, :, 0] > _SHORT, units[:, :, 0], units[:, :, 1])
