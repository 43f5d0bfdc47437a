"""Frames of an entity that sensors are attached to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import mujoco
import torch
from mjlab_core import unknown

from mjlab_sensors._elements import match_elements

if TYPE_CHECKING:
  from mjlab_sim import Simulation

FrameType = Literal["site", "body", "geom"]

_OBJECTS = {
  "site": (mujoco.mjtObj.mjOBJ_SITE, "site_xpos", "site_xmat"),
  "body": (mujoco.mjtObj.mjOBJ_BODY, "xpos", "xmat"),
  "geom": (mujoco.mjtObj.mjOBJ_GEOM, "geom_xpos", "geom_xmat"),
}


@dataclass(kw_only=True, frozen=True)
class FrameMatch:
  """Frames of the scene."""

  type: FrameType
  """What carries the frames."""
  pattern: str | tuple[str, ...]
  """Whole regular expressions over the names of the entity's own elements, or over full names without an entity."""
  entity: str | None = None
  """Entity that the elements belong to."""
  preserve_order: bool = False
  """Order the frames as the patterns are, instead of as they come in the model."""

  def __post_init__(self) -> None:
    if self.type not in _OBJECTS:
      raise ValueError(unknown("type of frame", self.type, _OBJECTS, f"FrameMatch {self.pattern!r}"))

  def resolve(self, spec: mujoco.MjSpec, entities: Mapping[str, Any], owner: str) -> list[str]:
    """Full names of the elements; NameMatchError if there are none."""
    return match_elements(
      spec, entities, self.type, self.pattern, entity=self.entity, preserve_order=self.preserve_order, owner=owner
    )


class FrameSet:
  """The frames of a `FrameMatch` in a simulation."""

  def __init__(self, sim: Simulation, frame_type: FrameType, names: tuple[str, ...], owner: str) -> None:
    obj, self._position, self._rotation = _OBJECTS[frame_type]
    ids = [mujoco.mj_name2id(sim.mj_model, obj, name) for name in names]
    for name, index in zip(names, ids, strict=True):
      if index < 0:
        raise ValueError(f"{owner}: the simulation's model has no {frame_type} {name!r}")
    self._sim = sim
    contiguous = ids == list(range(ids[0], ids[0] + len(ids)))
    # A slice is a view, an index list a gather.
    self._index = slice(ids[0], ids[0] + len(ids)) if contiguous else torch.tensor(ids, device=sim.device)
    match frame_type:
      case "site":
        bodies = [int(sim.mj_model.site_bodyid[i]) for i in ids]
      case "geom":
        bodies = [int(sim.mj_model.geom_bodyid[i]) for i in ids]
      case "body":
        bodies = ids
    self.body_ids: list[int] = bodies

  @property
  def positions(self) -> torch.Tensor:
    """Origins, world frame, (num_envs, num_frames, 3) [m]."""
    return getattr(self._sim.data, self._position)[:, self._index]

  @property
  def rotations(self) -> torch.Tensor:
    """Rotation matrices from frame to world, (num_envs, num_frames, 3, 3)."""
    return getattr(self._sim.data, self._rotation)[:, self._index]
