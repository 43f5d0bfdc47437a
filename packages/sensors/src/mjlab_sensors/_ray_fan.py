"""Rays that move with frames: one pattern at each frame, cast together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import torch

from mjlab_sensors.frames import FrameSet
from mjlab_sensors.patterns import RayPatternCfg

if TYPE_CHECKING:
  from mjlab_sim import RayHits, Simulation

RayAlignment = Literal["base", "yaw", "world"]

# Below this length of its projection to the ground, a frame's x axis no longer tells where it is heading.
_SHORT = 0.1


def _heading(rotation: torch.Tensor) -> torch.Tensor:
  """Unit direction on the ground in which frames head, (..., 2).

  It is the x axis projected to the ground, or, where that is nearly vertical, the y axis turned back by 90 degrees.
  """
  x_axis = rotation[..., :2, 0]
  y_axis = rotation[..., :2, 1]
  length = torch.linalg.vector_norm(x_axis, dim=-1, keepdim=True)
  turned = torch.stack((y_axis[..., 1], -y_axis[..., 0]), dim=-1)
  axis = torch.where(length > _SHORT, x_axis, turned)
  return axis / torch.linalg.vector_norm(axis, dim=-1, keepdim=True)


class RayFan:
  """Casts a pattern of rays from every frame, `num_rays` from each.

  The pattern turns with the frame ("base"), with its heading only ("yaw"), or not at all ("world"). Rays
  start `setback` [m] behind their starting points, so that a frame a little inside a surface still sees it.
  """

  def __init__(
    self,
    sim: Simulation,
    frames: FrameSet,
    pattern: RayPatternCfg,
    *,
    alignment: RayAlignment,
    setback: float,
    geom_groups: tuple[int, ...] | None,
    body_exclude: int,
  ) -> None:
    starts, directions = (torch.as_tensor(rows, dtype=sim.dtype, device=sim.device) for rows in pattern.rays())
    self.num_frames, self.num_rays = len(frames.body_ids), len(starts)
    self._frames, self._alignment = frames, alignment
    starts = starts - setback * directions
    shape = (sim.num_envs, self.num_frames, self.num_rays, 3)
    self._starts, self._directions = starts, directions
    # Rays that only turn about the vertical: what x and y of the heading each contribute, and what it does not touch.
    x, y, z = starts.unbind(-1)
    zero = torch.zeros_like(x)
    self._along = torch.stack((x, y, zero), dim=-1)
    self._across = torch.stack((-y, x, zero), dim=-1)
    self._above = torch.stack((zero, zero, z), dim=-1)
    self._world_directions = directions.expand(shape).contiguous()
    # Of a hit's height below its frame: the part that is fixed, and that which grows with the distance.
    self._drop_at_start = (-z).expand(self.num_frames, -1)
    self._drop_per_length = (-directions[:, 2]).expand(self.num_frames, -1)
    self._turns_directions = alignment == "yaw" and bool((directions[:, :2] != 0.0).any())
    groups = None if geom_groups is None else tuple(group in geom_groups for group in range(6))
    self._caster = sim.make_ray_caster(self.num_frames * self.num_rays, geomgroup=groups, bodyexclude=body_exclude)

  def cast(self) -> tuple[RayHits, torch.Tensor]:
    """What the rays hit now, and how far below its frame, each (num_envs, num_frames * num_rays) [m].

    The second is meaningless where nothing was hit. Distances count from `setback` behind the starting points.
    """
    position = self._frames.positions[:, :, None]
    drop_at_start, drop_per_length = self._drop_at_start, self._drop_per_length
    directions = self._world_directions
    if self._alignment == "world":
      origins = position + self._starts
    elif self._alignment == "yaw":
      heading = _heading(self._frames.rotations)[:, :, None]
      cos, sin = heading[..., :1], heading[..., 1:]
      # Not a matrix product: on a GPU those may run in reduced precision.
      origins = torch.addcmul(position + self._above, cos, self._along).addcmul_(sin, self._across)
      if self._turns_directions:
        x, y, z = self._directions.unbind(-1)
        cos, sin = cos[..., 0], sin[..., 0]
        directions = torch.stack((cos * x - sin * y, sin * x + cos * y, z.expand_as(cos * x)), dim=-1)
    else:
      rotation = self._frames.rotations[:, :, None]
      offsets = (rotation * self._starts[:, None]).sum(-1)
      directions = (rotation * self._directions[:, None]).sum(-1)
      origins = position + offsets
      drop_at_start, drop_per_length = -offsets[..., 2], -directions[..., 2]
    hits = self._caster.cast(origins.flatten(1, 2), directions.flatten(1, 2))
    below = torch.addcmul(drop_at_start, self._by_frame(hits.distance), drop_per_length)
    return hits, below.flatten(1)

  def _by_frame(self, values: torch.Tensor) -> torch.Tensor:
    return values.unflatten(1, (self.num_frames, self.num_rays))
