"""How high frames are above the ground beneath them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

import mujoco
import torch
from mjlab_core import unknown

from mjlab_sensors._flat_ground import plane_height, plane_is_fixed
from mjlab_sensors._ray_fan import RayAlignment, RayFan, check_rays
from mjlab_sensors.frames import FrameMatch, FrameSet
from mjlab_sensors.patterns import RayPatternCfg, RingPatternCfg
from mjlab_sensors.sensor import Sensor, SensorCfg

if TYPE_CHECKING:
  from mjlab_sim import Simulation

HeightReduction = Literal["min", "max", "mean", "none"]


@dataclass(kw_only=True)
class TerrainHeightSensorCfg(SensorCfg):
  """Height of frames above the ground, seen by rays."""

  frames: FrameMatch
  """The frames whose heights are measured."""
  pattern: RayPatternCfg = field(default_factory=RingPatternCfg)
  """The rays of each frame."""
  alignment: RayAlignment = "yaw"
  """Whether the pattern turns with the frame ("base"), with its heading only ("yaw"), or not at all ("world")."""
  reduction: HeightReduction = "min"
  """How the rays of a frame become one height: that over the highest ground ("min"), the lowest ("max") or the mean;
  "none" gives all."""
  max_distance: float = 1.0
  """How far below their frame rays see [m]. It is also the height that is read where they see nothing."""
  start_height: float = 0.1
  """How far behind the frame, against their direction, rays start [m]; ground up to this far above the frame is still
  seen."""
  geom_groups: tuple[int, ...] | None = (0,)
  """Geom groups that count as ground; None for all."""
  exclude_parent_body: bool = False
  """Rays of a frame pass through the geoms of the body that carries it."""

  def validate(self) -> None:
    check_rays(self.label, self.alignment, self.max_distance, self.start_height, self.geom_groups)
    if self.reduction not in get_args(HeightReduction):
      raise ValueError(unknown("reduction", self.reduction, get_args(HeightReduction), self.label))

  def _make(self, name: str) -> TerrainHeightSensor:
    return TerrainHeightSensor(name, self)


@dataclass(kw_only=True)
class TerrainHeightData:
  """Heights of the frames of a `TerrainHeightSensor`, in the order of its `frame_names`."""

  heights: torch.Tensor
  """Height of each frame above the ground, 0 when it is in the ground and `max_distance` where no ray sees any,
  (num_envs, num_frames) [m]; one of each ray, (num_envs, num_frames, num_rays), without reduction."""
  valid: torch.Tensor
  """Whether any ray saw ground, or each ray without reduction, bool of the shape of `heights`."""


class TerrainHeightSensor(Sensor[TerrainHeightData]):
  """Height of frames above the ground: z of the frame less z of the point that a ray hits.

  Rays are cast when the data are first asked for after a change of state, so rewards and terminations read the
  heights of the state they judge. Ground that a ray does not see (nothing there, or farther than `max_distance`) takes
  no part in the reduction. Above a level plane that never moves, rays straight down are not cast: what they would
  measure is the height above it.
  """

  _constants = frozenset({"_heights", "_valid"})
  cfg: TerrainHeightSensorCfg

  def __init__(self, name: str, cfg: TerrainHeightSensorCfg) -> None:
    super().__init__(name, cfg)
    self.frame_names: tuple[str, ...] = ()

  @property
  def num_frames(self) -> int:
    """Number of frames."""
    return len(self.frame_names)

  @property
  def num_rays(self) -> int:
    """Number of rays of each frame."""
    return self._fan.num_rays

  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    self.frame_names = tuple(self.cfg.frames.resolve(spec, entities, f"{self.label}: frames"))

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    cfg = self.cfg
    frames = FrameSet(sim, cfg.frames.type, self.frame_names, self.label)
    self._fan = RayFan(
      sim,
      frames,
      cfg.pattern,
      alignment=cfg.alignment,
      setback=cfg.start_height,
      max_distance=cfg.max_distance,
      geom_groups=cfg.geom_groups,
      exclude_parent_body=cfg.exclude_parent_body,
    )
    self._frames = frames
    excluded = set(frames.body_ids) if cfg.exclude_parent_body else set()
    self._plane = plane_height(sim, cfg.geom_groups, excluded) if self._fan.points_down else None
    shape = (sim.num_envs, self.num_frames, self.num_rays)[: 3 if cfg.reduction == "none" else 2]
    self._heights = torch.zeros(shape, dtype=sim.dtype, device=sim.device)
    self._unseen = torch.tensor(cfg.max_distance, dtype=sim.dtype, device=sim.device)
    self._valid = torch.zeros(shape, dtype=torch.bool, device=sim.device)

  def _read(self) -> TerrainHeightData:
    if self._plane is not None and plane_is_fixed(self.sim):
      return self._read_above_plane(self._plane)
    cfg = self.cfg
    rays = self._fan.cast()
    seen, height, from_inside = (
      values.unflatten(1, (self.num_frames, self.num_rays))
      for values in (rays.distance >= 0.0, rays.height, self._fan.from_inside(rays))
    )
    heights = (self._frames.heights[..., None] - height).clamp_(min=0.0).masked_fill_(from_inside, 0.0)
    heights = torch.where(seen, heights, self._unseen)
    if cfg.reduction == "none":
      self._valid.copy_(seen)
      self._heights.copy_(heights)
      return TerrainHeightData(heights=self._heights, valid=self._valid)
    torch.any(seen, dim=-1, out=self._valid)
    if cfg.reduction == "min":
      # What is not seen is as high as a reading can be, so it never wins over what is.
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
