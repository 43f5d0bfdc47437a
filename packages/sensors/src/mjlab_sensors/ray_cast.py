"""Ray-cast sensor: height scans, range finders, depth images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from mjlab_core import DebugDraw, quat_from_matrix

from mjlab_sensors.rays import RaySensor, RaySensorCfg

if TYPE_CHECKING:
  from mjlab_sim import Simulation


@dataclass(kw_only=True)
class RayCastSensorCfg(RaySensorCfg):
  """Hits of a pattern of rays from each of several frames."""

  identify_geoms: bool = False
  """Return the geoms that are hit. This is slower on a CPU with terrain of many geoms."""


@dataclass(kw_only=True)
class RayCastData:
  """Hits of the rays of a `RayCastSensor`, frame by frame.

  Ray r of frame f is number f * rays_per_frame + r, and num_rays counts all. The tensors are the sensor's own memory.
  """

  distances: torch.Tensor
  """Distance of each hit from the start of its ray, `start_height` included; -1 without a hit, (num_envs, num_rays)
  [m]."""
  valid: torch.Tensor
  """True for rays that hit something within their range, bool, (num_envs, num_rays)."""
  hit_pos_w: torch.Tensor
  """Point that is hit, world frame; the start of the ray without a hit, (num_envs, num_rays, 3) [m]."""
  normals_w: torch.Tensor
  """Surface normal at the hit, world frame; along the ray if it started inside the geom, and zero without a hit,
  (num_envs, num_rays, 3)."""
  frame_pos_w: torch.Tensor
  """Origins of the frames, world frame, (num_envs, num_frames, 3) [m]."""
  frame_mat_w: torch.Tensor
  """Rotation matrices from the frames to the world, (num_envs, num_frames, 3, 3)."""
  geom_ids: torch.Tensor | None = None
  """Geom that is hit, -1 for none, (num_envs, num_rays); None unless `identify_geoms`."""

  @property
  def frame_quat_w(self) -> torch.Tensor:
    """Orientations (w, x, y, z) of the frames, world frame, computed at each access, (num_envs, num_frames, 4)."""
    return quat_from_matrix(self.frame_mat_w)

  @property
  def pos_w(self) -> torch.Tensor:
    """Origin of the first frame, world frame, (num_envs, 3) [m]."""
    return self.frame_pos_w[:, 0]

  @property
  def quat_w(self) -> torch.Tensor:
    """Orientation (w, x, y, z) of the first frame, world frame, computed at each access, (num_envs, 4)."""
    return quat_from_matrix(self.frame_mat_w[:, 0])


class RayCastSensor(RaySensor[RayCastData], cfg=RayCastSensorCfg):
  """Sensor that casts a pattern of rays from each frame. Rays hit surfaces from both sides, planes only from above."""

  cfg: RayCastSensorCfg

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    self._hit_pos = torch.zeros_like(self._caster.origins)
    self._valid = torch.zeros(self._hit_pos.shape[:2], dtype=torch.bool, device=sim.device)

  def debug_draw(self, draw: DebugDraw) -> None:
    """Draw the frames and every hit."""
    data, worlds = self.data, list(draw.worlds)
    places, turns = data.frame_pos_w[worlds].flatten(0, 1), data.frame_quat_w[worlds].flatten(0, 1)
    draw.frames(places, turns, 2.0 * self._draw_size)
    draw.spheres(data.hit_pos_w[worlds][data.valid[worlds]], 0.5 * self._draw_size, (0.0, 0.8, 0.9, 1.0))

  def _read(self) -> RayCastData:
    hits, caster = self._cast(), self._caster
    torch.ge(hits.distance, 0.0, out=self._valid)
    torch.addcmul(caster.origins, caster.directions, hits.distance.clamp(min=0.0)[..., None], out=self._hit_pos)
    return RayCastData(
      distances=hits.distance,
      valid=self._valid,
      hit_pos_w=self._hit_pos,
      normals_w=hits.normal,
      frame_pos_w=self._frames.positions,
      frame_mat_w=self._frames.rotations,
      geom_ids=hits.geomid,
    )
