"""Rays that move with frames: one pattern at each frame, cast together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import torch

from mjlab_sensors.frames import FrameSet
from mjlab_sensors.patterns import RayPatternCfg

if TYPE_CHECKING:
  from mjlab_sim import Simulation

RayAlignment = Literal["base", "yaw", "world"]


class RayReading(NamedTuple):
  """What the rays of a fan hit, each (num_envs, num_frames * num_rays), frame by frame."""

  distance: torch.Tensor
  """Distance from where the ray starts, `setback` included; -1 where nothing was hit [m]."""
  below: torch.Tensor
  """How far the hit is below the ray's frame; meaningless where nothing was hit [m]."""
  from_inside: torch.Tensor
  """Whether the ray started inside what it hit, and leaves it there."""


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
    straight_down = bool((directions == directions.new_tensor((0.0, 0.0, -1.0))).all())
    self.points_down = straight_down and alignment != "base"
    """Whether all rays point straight down, whatever the frames do."""
    self._turns_directions = alignment == "yaw" and bool((directions[:, :2] != 0.0).any())
    groups = None if geom_groups is None else tuple(group in geom_groups for group in range(6))
    self._caster = sim.make_ray_caster(self.num_frames * self.num_rays, geomgroup=groups, bodyexclude=body_exclude)

  def cast(self) -> RayReading:
    """What the rays hit now. The simulation must be current (`sim.epoch`)."""
    position = self._frames.positions[:, :, None]
    drop_at_start, drop_per_length = self._drop_at_start, self._drop_per_length
    directions = self._world_directions
    if self._alignment == "world":
      origins = position + self._starts
    elif self._alignment == "yaw":
      heading = self._frames.headings[:, :, None]
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
    directions = directions.flatten(1, 2)
    hits = self._caster.cast(origins.flatten(1, 2), directions)
    if self.points_down:
      from_inside = hits.normal[..., 2] < 0.0
    else:
      from_inside = (hits.normal * directions).sum(-1) > 0.0
    below = torch.addcmul(drop_at_start, self._by_frame(hits.distance), drop_per_length)
    return RayReading(distance=hits.distance, below=below.flatten(1), from_inside=from_inside)

  def _by_frame(self, values: torch.Tensor) -> torch.Tensor:
    return values.unflatten(1, (self.num_frames, self.num_rays))
