"""What rays from a frame hit: height scans, range finders, depth images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import mujoco
import torch
from mjlab_core import quat_from_matrix

from mjlab_sensors._ray_fan import RayAlignment, RayFan, check_rays
from mjlab_sensors.frames import FrameMatch, FrameSet
from mjlab_sensors.patterns import GridPatternCfg, RayPatternCfg
from mjlab_sensors.sensor import Sensor, SensorCfg

if TYPE_CHECKING:
  from mjlab_sim import Simulation


@dataclass(kw_only=True)
class RayCastSensorCfg(SensorCfg):
  """A pattern of rays from each of several frames."""

  frames: FrameMatch
  """The frames that rays start from."""
  pattern: RayPatternCfg = field(default_factory=GridPatternCfg)
  """The rays of each frame."""
  alignment: RayAlignment = "base"
  """Whether the pattern turns with the frame ("base"), with its heading only ("yaw"), or not at all ("world")."""
  max_distance: float = 10.0
  """How far from their points of the pattern rays see [m]."""
  start_height: float = 0.0
  """How far behind these points, against their direction, rays start [m]. A height scan whose rays start at the frame
  itself starts them inside of terrain that is higher than the frame; a height above all terrain around it sees that."""
  geom_groups: tuple[int, ...] | None = (0, 1, 2)
  """Geom groups that rays see; None for all."""
  exclude_parent_body: bool = True
  """Rays of a frame pass through the geoms of the body that carries it."""
  identify_geoms: bool = False
  """Tell which geoms are hit. On a CPU that is slower on terrain of many geoms."""

  def validate(self) -> None:
    check_rays(self.label, self.alignment, self.max_distance, self.start_height, self.geom_groups)

  def _make(self, name: str) -> RayCastSensor:
    return RayCastSensor(name, self)


@dataclass(kw_only=True)
class RayCastData:
  """Hits of the rays of a `RayCastSensor`, frame by frame: ray r of frame f is number f * rays_per_frame + r, and
  num_rays counts all. Tensors are the sensor's own: read them, and clone what must outlive the step."""

  distances: torch.Tensor
  """Distance of each hit from where its ray starts, `start_height` included; -1 where nothing is hit,
  (num_envs, num_rays) [m]."""
  valid: torch.Tensor
  """Whether the ray hits anything within its reach, bool, (num_envs, num_rays)."""
  hit_pos_w: torch.Tensor
  """Point that is hit, world frame; where the ray starts if there is none, (num_envs, num_rays, 3) [m]."""
  normals_w: torch.Tensor
  """Surface normal at the hit, world frame; along the ray where it leaves what it started in, and zero where nothing
  is hit, (num_envs, num_rays, 3)."""
  frame_pos_w: torch.Tensor
  """Origins of the frames, world frame, (num_envs, num_frames, 3) [m]."""
  frame_mat_w: torch.Tensor
  """Rotation matrices from the frames to the world, (num_envs, num_frames, 3, 3)."""
  geom_ids: torch.Tensor | None = None
  """Geom that is hit, -1 for none, (num_envs, num_rays); None unless `identify_geoms`."""

  @property
  def frame_quat_w(self) -> torch.Tensor:
    """Orientations (w, x, y, z) of the frames, world frame, computed when asked for, (num_envs, num_frames, 4)."""
    return quat_from_matrix(self.frame_mat_w)

  @property
  def pos_w(self) -> torch.Tensor:
    """Origin of the first frame, world frame, (num_envs, 3) [m]."""
    return self.frame_pos_w[:, 0]

  @property
  def quat_w(self) -> torch.Tensor:
    """Orientation (w, x, y, z) of the first frame, world frame, computed when asked for, (num_envs, 4)."""
    return quat_from_matrix(self.frame_mat_w[:, 0])


class RayCastSensor(Sensor[RayCastData]):
  """Casts a pattern of rays from each of its frames, in all worlds at once.

  Rays are cast when the data are first asked for after a change of state, so whoever reads them sees the state that
  is. Surfaces are hit from both sides, but planes from above only.
  """

  _constants = frozenset({"_hit_pos", "_valid"})
  cfg: RayCastSensorCfg

  def __init__(self, name: str, cfg: RayCastSensorCfg) -> None:
    super().__init__(name, cfg)
    self.frame_names: tuple[str, ...] = ()

  @property
  def num_frames(self) -> int:
    """Number of frames."""
    return len(self.frame_names)

  @property
  def rays_per_frame(self) -> int:
    """Number of rays of each frame."""
    return self._fan.num_rays

  @property
  def num_rays(self) -> int:
    """Number of rays of all frames of a world."""
    return self.num_frames * self.rays_per_frame

  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    self.frame_names = tuple(self.cfg.frames.resolve(spec, entities, f"{self.label}: frames"))

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    cfg = self.cfg
    self._frames = FrameSet(sim, cfg.frames.type, self.frame_names, self.label)
    self._fan = RayFan(
      sim,
      self._frames,
      cfg.pattern,
      alignment=cfg.alignment,
      setback=cfg.start_height,
      max_distance=cfg.max_distance,
      geom_groups=cfg.geom_groups,
      exclude_parent_body=cfg.exclude_parent_body,
      geomid=cfg.identify_geoms,
    )
    shape = (sim.num_envs, self.num_rays)
    self._hit_pos = torch.zeros((*shape, 3), dtype=sim.dtype, device=sim.device)
    self._valid = torch.zeros(shape, dtype=torch.bool, device=sim.device)

  def _read(self) -> RayCastData:
    rays = self._fan.cast()
    torch.ge(rays.distance, 0.0, out=self._valid)
    torch.addcmul(rays.origins, rays.directions, rays.distance.clamp(min=0.0)[..., None], out=self._hit_pos)
    return RayCastData(
      distances=rays.distance,
      valid=self._valid,
      hit_pos_w=self._hit_pos,
      normals_w=rays.normal,
      frame_pos_w=self._frames.positions,
      frame_mat_w=self._frames.rotations,
      geom_ids=rays.geomid,
    )
