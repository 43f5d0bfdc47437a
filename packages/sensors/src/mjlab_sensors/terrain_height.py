"""Terrain-height sensor: heights of frames above the ground beneath them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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
  """One height from the rays of a frame: over the highest ground ("min"), over the lowest ("max"), or the mean; "none"
  keeps the height of each ray."""
  max_distance: RayReach = 1.0
  """Range of the rays below their frame [m], and the reading where no ray hits ground."""
  start_height: NonNegative = 0.1
  """Distance behind the frame, against their direction, at which rays start [m]; they hit ground up to so far above
  the frame."""
  geom_groups: GeomGroups = (0,)
  """Geom groups that count as ground; None for all."""
  exclude_parent_body: bool = False

  def _make(self, name: str) -> TerrainHeightSensor:
    return TerrainHeightSensor(name, self)


@dataclass(kw_only=True)
class TerrainHeightData:
  """Heights of the frames of a `TerrainHeightSensor`, in the order of its `frame_names`."""

  heights: torch.Tensor
  """Height of each frame above the ground, 0 inside the ground and `max_distance` where no ray hits any,
  (num_envs, num_frames) [m]; of each ray, (num_envs, num_frames, num_rays), without reduction."""
  valid: torch.Tensor
  """True where any ray of the frame hit ground, or the ray itself without reduction, bool, shaped as `heights`."""


class TerrainHeightSensor(RaySensor[TerrainHeightData]):
  """Height of frames above the ground: z of the frame less z of the point that a ray hits.

  Rays that hit nothing within `max_distance` take no part in the reduction. Above a level plane that never moves, rays
  straight down are not cast: they would measure the height above the plane.
  """

  cfg: TerrainHeightSensorCfg

  @property
  def num_rays(self) -> int:
    """Number of rays of each frame."""
    return self.rays_per_frame

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    cfg = self.cfg
    self._plane: float | None = None
    if self._points_down:
      groups = range(mujoco.mjNGROUP) if cfg.geom_groups is None else cfg.geom_groups
      excludes = cfg.exclude_parent_body or cfg.exclude_own_tree
      self._plane = _plane_height(sim, groups, self._frames.body_ids if excludes else [], trees=cfg.exclude_own_tree)
    shape = (sim.num_envs, self.num_frames, self.num_rays)[: 3 if cfg.reduction == "none" else 2]
    self._heights = torch.zeros(shape, dtype=sim.dtype, device=sim.device)
    self._unseen = torch.tensor(cfg.max_distance, dtype=sim.dtype, device=sim.device)
    self._valid = torch.zeros(shape, dtype=torch.bool, device=sim.device)

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
      return self._read_above_plane(self._plane)
    cfg = self.cfg
    rays = self._cast()
    seen, height, from_inside = (
      values.unflatten(1, (self.num_frames, self.num_rays))
      for values in (rays.distance >= 0.0, rays.height, self._leaves_inside(rays))
    )
    heights = (self._frames.heights[..., None] - height).clamp_(min=0.0).masked_fill_(from_inside, 0.0)
    heights = torch.where(seen, heights, self._unseen)
    if cfg.reduction == "none":
      self._valid.copy_(seen)
      self._heights.copy_(heights)
      return TerrainHeightData(heights=self._heights, valid=self._valid)
    torch.any(seen, dim=-1, out=self._valid)
    if cfg.reduction == "min":
      # A ray without a hit reads the largest height, so it never wins over one with a hit.
      torch.amin(heights, dim=-1, out=self._heights)
      return TerrainHeightData(heights=self._heights, valid=self._valid)
    heights = heights * seen
    if cfg.reduction == "max":
      torch.amax(heights, dim=-1, out=self._heights)
    else:
      torch.div(heights.sum(dim=-1), seen.sum(dim=-1).clamp_(min=1), out=self._heights)
    torch.where(self._valid, self._heights, self._unseen, out=self._heights)
    return TerrainHeightData(heights=self._heights, valid=self._valid)

  def _read_above_plane(self, plane: float) -> TerrainHeightData:
    above = self._frames.heights - plane
    if self.cfg.reduction == "none":
      above = above[..., None].expand_as(self._heights)
    torch.le(above, self.cfg.max_distance, out=self._valid)
    torch.clamp(above, 0.0, self.cfg.max_distance, out=self._heights)
    return TerrainHeightData(heights=self._heights, valid=self._valid)


def _plane_height(sim: Simulation, geom_groups: Iterable[int], excluded: list[int], *, trees: bool) -> float | None:
  """World height of the only geom in `geom_groups` if it is a fixed, infinite, horizontal plane [m]; else None.

  Geoms of bodies in `excluded`, or of their kinematic `trees`, through which some rays pass, do not count where all
  rays pass through the same.
  """
  model = sim.mj_model
  owner = model.body_rootid if trees else np.arange(model.nbody)
  through = {int(owner[body]) for body in excluded}
  unseen = through if len(through) == 1 else set()
  owners = owner[model.geom_bodyid]
  seen = [g for g in range(model.ngeom) if model.geom_group[g] in geom_groups and owners[g] not in unseen]
  if len(seen) != 1 or owners[seen[0]] in through:
    return None
  geom = seen[0]
  body = int(model.geom_bodyid[geom])
  is_fixed = model.body_weldid[body] == 0 and model.body_mocapid[model.body_rootid[body]] < 0
  is_infinite = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE and not model.geom_size[geom, :2].any()
  if not (is_fixed and is_infinite):
    return None
  data = mujoco.MjData(model)
  mujoco.mj_kinematics(model, data)
  is_level = np.allclose(data.geom_xmat[geom].reshape(3, 3)[:, 2], (0.0, 0.0, 1.0), atol=1e-9)
  return float(data.geom_xpos[geom, 2]) if is_level else None
