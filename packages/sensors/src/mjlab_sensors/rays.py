"""Base of ray sensors: one pattern of rays at each of several frames, all cast together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import mujoco
import torch
from mjlab_core import Limits, NonNegative

from mjlab_sensors.frames import FrameMatch, FrameSet
from mjlab_sensors.patterns import GridPatternCfg, RayPatternCfg
from mjlab_sensors.sensor import GeomGroups, Sensor, SensorCfg, group_mask

if TYPE_CHECKING:
  from mjlab_sim import RayHits, Simulation

T = TypeVar("T")
RayAlignment = Literal["base", "yaw", "world"]
RayReach = Annotated[float, Limits(gt=0, finite=False)]


@dataclass(kw_only=True)
class RaySensorCfg(SensorCfg):
  """A pattern of rays from each of several frames."""

  frames: FrameMatch
  """The frames that rays start from."""
  pattern: RayPatternCfg = field(default_factory=GridPatternCfg)
  """The rays of each frame."""
  alignment: RayAlignment = "base"
  """Rotation of the pattern: with the frame ("base"), with the frame's heading only ("yaw"), or none ("world")."""
  max_distance: RayReach = 10.0
  """Range of a ray from its point of the pattern [m]."""
  start_height: NonNegative = 0.0
  """Distance from the points of the pattern back to the start of the rays, against their direction [m]. The rays of a
  height scan miss terrain that is higher than their start."""
  geom_groups: GeomGroups = (0, 1, 2)
  """Geom groups that rays see; None for all. Geoms of zero alpha are never seen."""
  exclude_parent_body: bool = True
  """Rays of a frame pass through the geoms of the body that carries it."""
  exclude_own_tree: bool = False
  """Rays of a frame pass through all bodies of its kinematic tree, such as a whole robot."""


class RaySensor(Sensor[T]):
  """Sensor that casts a pattern of rays from each of its frames, in all worlds at once.

  Rays are cast when the data are first read after a change of state, so they always show the present state.
  """

  # A `RaySensorCfg`, of another class in each subclass.
  cfg: Any
  frame_names: tuple[str, ...] = ()
  rays_per_frame: int
  """Number of rays of each frame."""

  @property
  def num_frames(self) -> int:
    """Number of frames."""
    return len(self.frame_names)

  @property
  def num_rays(self) -> int:
    """Number of rays of all frames."""
    return self.num_frames * self.rays_per_frame

  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    frames = self.cfg.frames
    self.frame_names = frames.names_in(spec, entities, frames.type, f"{self.label}: frames")

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    cfg = self.cfg
    self._frames = frames = FrameSet(sim, cfg.frames.type, self.frame_names)
    rows = cfg.pattern.resolve(sim.mj_model).rays()
    starts, directions = (torch.as_tensor(row, dtype=sim.dtype, device=sim.device) for row in rows)
    self.rays_per_frame = len(starts)
    starts = starts - cfg.start_height * directions
    self._starts, self._pointing = self._parts(starts), self._parts(directions)
    self._zero = torch.zeros(sim.num_envs, self.num_frames, 1, 3, dtype=sim.dtype, device=sim.device)
    self._one = torch.ones((), dtype=sim.dtype, device=sim.device)
    straight_down = bool((directions == directions.new_tensor((0.0, 0.0, -1.0))).all())
    self._points_down = straight_down and cfg.alignment != "base"
    self._turns_directions = cfg.alignment == "base" or (cfg.alignment == "yaw" and bool(directions[:, :2].any()))
    self._excluded = frames.body_ids if cfg.exclude_parent_body or cfg.exclude_own_tree else []
    self._caster = sim.make_ray_caster(
      self.num_frames * self.rays_per_frame,
      geomgroup=group_mask(cfg.geom_groups),
      bodyexclude=[body for body in self._excluded for _ in range(self.rays_per_frame)] or -1,
      exclude_trees=cfg.exclude_own_tree,
      max_distance=cfg.max_distance + cfg.start_height,
      geomid=getattr(cfg, "identify_geoms", False),
    )
    shape = (self.num_frames, self.rays_per_frame)
    self._origins, self._directions = (
      rays.unflatten(1, shape) for rays in (self._caster.origins, self._caster.directions)
    )
    self._directions.copy_(directions)

  def _cast(self) -> RayHits:
    """Cast the rays; the simulation must be current (`sim.version`)."""
    position, factors = self._frames.positions[:, :, None], self._factors()
    self._combine(position, factors, self._starts, out=self._origins)
    if self._turns_directions:
      self._combine(self._zero, factors, self._pointing, out=self._directions)
    return self._caster.cast()

  # A vector of the pattern in the world is a sum of three products, each of a factor from the frames and a constant.
  # It is not written as a matrix product: on a GPU those may run in reduced precision.

  def _parts(self, rows: torch.Tensor) -> tuple[torch.Tensor, ...]:
    x, y, z = rows.split(1, dim=-1)
    if self.cfg.alignment == "base":
      return x, y, z
    if self.cfg.alignment == "world":
      return (rows,)
    zero = torch.zeros_like(x)
    return torch.cat((zero, zero, z), -1), torch.cat((x, y, zero), -1), torch.cat((-y, x, zero), -1)

  def _factors(self) -> tuple[torch.Tensor, ...]:
    if self.cfg.alignment == "base":
      return self._frames.rotations[:, :, None].unbind(-1)
    if self.cfg.alignment == "world":
      return (self._one,)
    return self._one, *self._frames.headings[:, :, None].split(1, dim=-1)

  @staticmethod
  def _combine(
    start: torch.Tensor, factors: tuple[torch.Tensor, ...], parts: tuple[torch.Tensor, ...], *, out: torch.Tensor
  ) -> None:
    torch.addcmul(start, factors[0], parts[0], out=out)
    for factor, part in zip(factors[1:], parts[1:], strict=True):
      out.addcmul_(factor, part)

  def _leaves_inside(self, normal: torch.Tensor) -> torch.Tensor:
    """Return True for rays that started inside the geom they hit with this normal, (num_envs, num_rays) bool."""
    if self._points_down:
      return normal[..., 2] < 0.0
    return (normal * self._caster.directions).sum(-1) > 0.0
