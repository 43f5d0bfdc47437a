"""Terrain-height sensor: heights of frames above the ground beneath them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import mujoco
import numpy as np
import torch
from mjlab_core import DebugDraw, NonNegative

from mjlab_sensors.patterns import RayPatternCfg, RingPatternCfg
from mjlab_sensors.rays import RayAlignment, RayReach, RaySensor, RaySensorCfg
from mjlab_sensors.sensor import GeomGroups

if TYPE_CHECKING:
  from mjlab_sim import Simulation

HeightReduction = Literal["min", "max", "mean", "none"]


@dataclass(kw_only=True)
class TerrainHeightSensorCfg(RaySensorCfg):
  """Height of frames above the ground, measured by rays."""

  pattern: RayPatternCfg = field(default_factory=RingPatternCfg)
  alignment: RayAlignment = "yaw"
  reduction: HeightReduction = "min"
  """Reduction of the rays of a frame to one height: above the highest ground ("min"), above the lowest ("max"), or the
  mean; "none" keeps the height of each ray."""
  max_distance: RayReach = 1.0
  """Range of the rays below their frame [m], and the reading where no ray hits ground."""
  start_height: NonNegative = 0.1
  """Distance from the frame back to the start of the rays, against their direction [m]. Ground up to this far above the
  frame is hit."""
  geom_groups: GeomGroups = (0,)
  """Geom groups that count as ground; None for all."""
  exclude_parent_body: bool = False


@dataclass(kw_only=True)
class TerrainHeightData:
  """Heights of the frames of a `TerrainHeightSensor`, in the order of its `frame_names`."""

  heights: torch.Tensor
  """Height of each frame above the ground, 0 inside the ground and `max_distance` where no ray hits any,
  (num_envs, num_frames) [m]; of each ray, (num_envs, num_frames, rays_per_frame), without reduction."""
  valid: torch.Tensor
  """True if a ray of the frame hit ground, or the ray itself without reduction, bool, shaped as `heights`."""


class TerrainHeightSensor(RaySensor[TerrainHeightData], cfg=TerrainHeightSensorCfg):
  """Height of frames above the ground: z of the frame less z of the point that a ray hits.

  Rays that hit nothing within `max_distance` are left out of the reduction. Above one fixed level plane, rays straight
  down that pass through no body are not cast: the reading is the height above the plane.
  """

  cfg: TerrainHeightSensorCfg

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    cfg = self.cfg
    self._plane = self._plane_height() if self._points_down else None
    shape = (sim.num_envs, self.num_frames, self.rays_per_frame)[: 3 if cfg.reduction == "none" else 2]
    self._reduced = TerrainHeightData(
      heights=torch.zeros(shape, dtype=sim.dtype, device=sim.device),
      valid=torch.zeros(shape, dtype=torch.bool, device=sim.device),
    )
    self._unseen = torch.tensor(cfg.max_distance, dtype=sim.dtype, device=sim.device)

  def debug_draw(self, draw: DebugDraw) -> None:
    """Draw the height of each frame as a line down to the ground; without reduction, to the highest ground."""
    data, worlds = self.data, list(draw.worlds)
    heights, valid = data.heights[worlds], data.valid[worlds]
    if self.cfg.reduction == "none":
      heights, valid = heights.amin(-1), valid.any(-1)
    top = self._frames.positions[worlds][valid]
    bottom = top.clone()
    bottom[:, 2] -= heights[valid]
    draw.lines(top, bottom, (0.1, 0.8, 0.2, 1.0), 0.1 * self._draw_size)
    draw.spheres(bottom, 0.4 * self._draw_size, (0.1, 0.8, 0.2, 1.0))

  def _read(self) -> TerrainHeightData:
    if self._plane is not None and self.sim.fixed_geoms_are_in_place():
      self._read_above(self._plane)
    else:
      self._read_rays()
    return self._reduced

  def _read_rays(self) -> None:
    hits, caster, out = self._cast(), self._caster, self._reduced
    hit_height = torch.addcmul(caster.origins[..., 2], hits.distance, caster.directions[..., 2])
    seen, height, from_inside = (
      values.unflatten(1, (self.num_frames, self.rays_per_frame))
      for values in (hits.distance >= 0.0, hit_height, self._leaves_inside(hits.normal))
    )
    heights = (self._frames.heights[..., None] - height).clamp_(min=0.0).masked_fill_(from_inside, 0.0)
    heights = torch.where(seen, heights, self._unseen)
    reduction = self.cfg.reduction
    if reduction == "none":
      out.valid.copy_(seen)
      out.heights.copy_(heights)
      return
    torch.any(seen, dim=-1, out=out.valid)
    if reduction == "min":
      # A ray without a hit reads the largest height, so it never wins over one with a hit.
      torch.amin(heights, dim=-1, out=out.heights)
      return
    heights = heights * seen
    if reduction == "max":
      torch.amax(heights, dim=-1, out=out.heights)
    else:
      torch.div(heights.sum(dim=-1), seen.sum(dim=-1).clamp_(min=1), out=out.heights)
    torch.where(out.valid, out.heights, self._unseen, out=out.heights)

  def _read_above(self, plane: float) -> None:
    above, out = self._frames.heights - plane, self._reduced
    if self.cfg.reduction == "none":
      above = above[..., None].expand_as(out.heights)
    torch.le(above, self.cfg.max_distance, out=out.valid)
    torch.clamp(above, 0.0, self.cfg.max_distance, out=out.heights)

  def _plane_height(self) -> float | None:
    """Return the world height of the ground if it is one fixed, infinite, horizontal plane [m]; else None."""
    groups, model = self.cfg.geom_groups, self.sim.mj_model
    seen = np.flatnonzero(np.isin(model.geom_group, range(mujoco.mjNGROUP) if groups is None else groups))
    if self._excluded or len(seen) != 1:
      return None
    geom = int(seen[0])
    body = model.geom_bodyid[geom]
    is_fixed = model.body_weldid[body] == 0 and model.body_mocapid[model.body_rootid[body]] < 0
    is_infinite = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE and not model.geom_size[geom, :2].any()
    if not (is_fixed and is_infinite):
      return None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    is_level = np.allclose(data.geom_xmat[geom].reshape(3, 3)[:, 2], (0.0, 0.0, 1.0), atol=1e-9)
    return float(data.geom_xpos[geom, 2]) if is_level else None
