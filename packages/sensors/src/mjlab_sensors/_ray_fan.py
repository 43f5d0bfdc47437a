"""Rays that move with frames: one pattern at each frame, cast together."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import mujoco
import torch
from mjlab_core import unknown

from mjlab_sensors.frames import FrameSet
from mjlab_sensors.patterns import RayPatternCfg

if TYPE_CHECKING:
  from mjlab_sim import Simulation

RayAlignment = Literal["base", "yaw", "world"]


def check_rays(
  label: str, alignment: str, max_distance: float, start_height: float, geom_groups: tuple[int, ...] | None
) -> None:
  """Refuse settings of rays that are wrong whatever the scene.

  Raises:
    ValueError: naming the sensor `label` and the setting.
  """
  if alignment not in get_args(RayAlignment):
    raise ValueError(unknown("alignment", alignment, get_args(RayAlignment), label))
  if not max_distance > 0.0:
    raise ValueError(f"{label}: max_distance must be positive, not {max_distance}")
  if not 0.0 <= start_height < inf:
    raise ValueError(f"{label}: start_height must not be negative, but is {start_height}")
  if geom_groups is not None and not (geom_groups and all(0 <= group < mujoco.mjNGROUP for group in geom_groups)):
    raise ValueError(f"{label}: geom_groups must name groups from 0 to {mujoco.mjNGROUP - 1}, not {geom_groups}")


class RayReading(NamedTuple):
  """Rays of a fan and what they hit, (num_envs, num_frames * num_rays, ...), frame by frame; world frame."""

  origins: torch.Tensor
  """Where the rays start, `setback` behind the points of the pattern, (..., 3) [m]."""
  directions: torch.Tensor
  """Unit directions, (..., 3)."""
  distance: torch.Tensor
  """Distance from where the ray starts; -1 where nothing was hit [m]."""
  normal: torch.Tensor
  """Surface normal at the hit; zero where nothing was hit, (..., 3)."""
  geomid: torch.Tensor | None
  """Geom that was hit, -1 where nothing was; None if the fan does not tell."""

  @property
  def height(self) -> torch.Tensor:
    """World height of the hit; meaningless where nothing was hit [m]."""
    return torch.addcmul(self.origins[..., 2], self.distance, self.directions[..., 2])


class RayFan:
  """Casts a pattern of rays from every frame, `num_rays` from each.

  The pattern turns with the frame ("base"), with its heading only ("yaw"), or not at all ("world"). Rays
  start `setback` [m] behind their starting points, so that a frame a little inside a surface still sees it, and see
  up to `max_distance` [m] in front of these.
  """

  def __init__(
    self,
    sim: Simulation,
    frames: FrameSet,
    pattern: RayPatternCfg,
    *,
    alignment: RayAlignment,
    setback: float,
    max_distance: float,
    geom_groups: tuple[int, ...] | None,
    exclude_parent_body: bool,
    geomid: bool = False,
  ) -> None:
    rays = pattern.resolve(sim.mj_model).rays()
    starts, directions = (torch.as_tensor(rows, dtype=sim.dtype, device=sim.device) for rows in rays)
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
    straight_down = bool((directions == directions.new_tensor((0.0, 0.0, -1.0))).all())
    self.points_down = straight_down and alignment != "base"
    """Whether all rays point straight down, whatever the frames do."""
    self._turns_directions = alignment == "yaw" and bool((directions[:, :2] != 0.0).any())
    groups = None if geom_groups is None else tuple(group in geom_groups for group in range(mujoco.mjNGROUP))
    exclude = [body if exclude_parent_body else -1 for body in frames.body_ids for _ in range(self.num_rays)]
    self._caster = sim.make_ray_caster(
      len(exclude), geomgroup=groups, bodyexclude=exclude, max_distance=max_distance + setback, geomid=geomid
    )

  def cast(self) -> RayReading:
    """What the rays hit now. The simulation must be current (`sim.epoch`)."""
    position = self._frames.positions[:, :, None]
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
      columns = self._frames.rotations[:, :, None].unbind(-1)
      origins, directions = (self._turned(columns, rows) for rows in (self._starts, self._directions))
      origins += position
    origins, directions = origins.flatten(1, 2), directions.flatten(1, 2)
    hits = self._caster.cast(origins, directions)
    return RayReading(origins, directions, hits.distance, hits.normal, hits.geomid)

  def from_inside(self, rays: RayReading) -> torch.Tensor:
    """Whether rays started inside what they hit, and leave it there, (num_envs, num_frames * num_rays) bool."""
    if self.points_down:
      return rays.normal[..., 2] < 0.0
    return (rays.normal * rays.directions).sum(-1) > 0.0

  @staticmethod
  def _turned(columns: tuple[torch.Tensor, ...], rows: torch.Tensor) -> torch.Tensor:
    """Rows turned by the matrix of these columns, a column at a time: what it takes to hold the products is large."""
    x, y, z = (coordinate[:, None] for coordinate in rows.unbind(-1))
    return torch.addcmul(columns[0] * x, columns[1], y).addcmul_(columns[2], z)
