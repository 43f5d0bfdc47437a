"""Camera sensor: colours, depth, and the object in each pixel."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import mujoco
import torch
from mjlab_core import (
  Count,
  DebugDraw,
  Items,
  MjlabError,
  Positive,
  check_name,
  quat_from_matrix,
  where_,
)
from mjlab_sim import DataType

from mjlab_sensors.frames import FrameSet
from mjlab_sensors.native._elements import names_of
from mjlab_sensors.pinhole import physical_intrinsics, resolution_of, resolution_problems
from mjlab_sensors.sensor import GeomGroups, Sensor, SensorCfg, group_mask

if TYPE_CHECKING:
  from mjlab_sim import Simulation

_ORTHOGRAPHIC = mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC


@dataclass(kw_only=True)
class CameraSensorCfg(SensorCfg):
  """Images of a camera of the scene (`camera`), or of a new camera with the name of the sensor.

  Several sensors may use one camera, each with separate size, data and rate.
  """

  camera: str | None = None
  """Full name of a camera of the scene, such as `robot/head`. It excludes body, pos, quat and orthographic, which
  describe a new camera. With `fovy`, the sensor uses a copy with that field of view and the name of the sensor; the
  fields of the copy are those to randomise."""
  body: str | None = None
  """Full name of the body that a new camera is fixed to; None is the world, where each world of a scene has another
  origin."""
  pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
  """Position in the frame of the body [m]."""
  quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
  """Orientation (w, x, y, z) in that frame: the camera looks along its negative z axis, x points right and y up in the
  image."""
  fovy: Positive | None = None
  """Vertical field of view [deg], by default 45; the height of the image [m] if orthographic."""
  orthographic: bool = False
  """Draw a new camera's image with parallel rays."""
  width: Count = 0
  """Pixels of a row; 0 takes the resolution of `camera`."""
  height: Count = 0
  """Rows; 0 takes the resolution of `camera`."""
  data_types: Annotated[tuple[DataType, ...], Items(ge=1)] = ("rgb",)
  """Images to draw: "rgb", "depth" along the optical axis, "distance" along each pixel's ray, "segmentation"."""
  update_period: Count = 0
  """Physics steps from one image to the next; 0 draws every state. In between the image is held. A world that was reset
  gets an image at once, and counts from there."""
  geom_groups: GeomGroups = (0, 1, 2)
  """Geom groups that are drawn; None for all."""
  use_textures: bool = True
  """Draw textures."""
  use_shadows: bool = False
  """Let lights cast shadows."""

  def problems(self) -> Iterator[str]:
    yield from resolution_problems(self.width, self.height, self.camera)
    if self.camera is not None:
      new = ("body", "pos", "quat", "orthographic")
      if given := [field for field in new if getattr(self, field) != getattr(CameraSensorCfg, field)]:
        yield f"camera {self.camera!r} exists already; leave {', '.join(given)} out"
    elif self.orthographic and self.fovy is None:
      yield "an orthographic camera needs fovy, the height of its image [m]"
    if self.fovy is not None and self.fovy >= 180.0 and not self.orthographic:
      yield f"fovy must be below 180 degrees, got {self.fovy}"
    if not any(self.quat):
      yield "quat must not be zero"


@dataclass(kw_only=True)
class CameraData:
  """Images of a `CameraSensor`, the top row first; None for images that are not drawn.

  The tensors are the sensor's own memory.
  """

  rgb: torch.Tensor | None
  """Colours, uint8, (num_envs, 3, height, width)."""
  depth: torch.Tensor | None
  """Distance along the optical axis, float32; -1 where the pixel shows nothing, (num_envs, 1, height, width) [m]."""
  distance: torch.Tensor | None
  """Distance along the ray of the pixel, float32; -1 where it shows nothing, (num_envs, 1, height, width) [m]."""
  segmentation: torch.Tensor | None
  """Id and type (`mujoco.mjtObj`) of the object, int32; -1 and -1 for none, (num_envs, 2, height, width)."""
  pos_w: torch.Tensor
  """Position of the camera when the images were drawn, world frame, (num_envs, 3) [m]."""
  mat_w: torch.Tensor
  """Rotation matrix from the camera to the world at that time; it looks along its negative z axis, (num_envs, 3, 3)."""

  @property
  def rgb_float(self) -> torch.Tensor | None:
    """Colours from 0 to 1, float32, computed at each access, (num_envs, 3, height, width)."""
    return None if self.rgb is None else self.rgb / 255.0

  @property
  def quat_w(self) -> torch.Tensor:
    """Orientation (w, x, y, z) of the camera, world frame, computed at each access, (num_envs, 4)."""
    return quat_from_matrix(self.mat_w)


class CameraSensor(Sensor[CameraData], cfg=CameraSensorCfg):
  """Images of one camera in all worlds, drawn together by MuJoCo Warp's renderer, on a CPU too.

  They are drawn when the data are first read after a change of state, in the worlds that are due. Textures, colours,
  lights, sizes of geoms, poses and fields of view are those of each world. Surfaces are visible from outside only, so
  a camera inside a shell looks through it. Nothing is visible beyond the model's far plane,
  `vis.map.zfar * stat.extent`. A height field shows its surface, without its walls.
  """

  cfg: CameraSensorCfg

  def __init__(self, cfg: CameraSensorCfg) -> None:
    super().__init__(cfg)
    self.camera_name = cfg.name if cfg.camera is None or cfg.fovy is not None else cfg.camera
    """Full name of the camera."""
    self.width, self.height = cfg.width, cfg.height

  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    cfg, cameras = self.cfg, names_of(spec, "camera")
    if cfg.camera is None:
      body = "world" if cfg.body is None else check_name("body", cfg.body, names_of(spec, "body"), self.label)
      parent, fields = spec.body(body), {"pos": cfg.pos, "quat": cfg.quat}
      if cfg.orthographic:
        fields["proj"] = _ORTHOGRAPHIC
    else:
      like = spec.camera(check_name("camera", cfg.camera, cameras, self.label))
      if not self.width:
        self.width, self.height = resolution_of(self.label, cfg.camera, like.resolution)
      if cfg.fovy is None:
        return
      parent = like.parent
      fields = {field: getattr(like, field) for field in ("pos", "quat", "alt", "mode", "targetbody", "proj")}
    if self.name in cameras:
      raise MjlabError(f"{self.label}: the scene already has this camera; set camera={self.name!r}, or another name")
    camera = parent.add_camera(name=self.name)
    for field, value in fields.items():
      setattr(camera, field, value)
    camera.resolution = self.width, self.height
    if cfg.fovy is not None:
      camera.fovy = cfg.fovy

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    cfg = self.cfg
    self._frame = FrameSet(sim, "camera", (self.camera_name,))
    self._camera = sim.mj_model.camera(self.camera_name).id
    self._is_orthographic = sim.mj_model.cam_projection[self._camera] == _ORTHOGRAPHIC
    self._renderer = sim.make_renderer(
      self._camera,
      self.width,
      self.height,
      cfg.data_types,
      geomgroup=group_mask(cfg.geom_groups),
      textures=cfg.use_textures,
      shadows=cfg.use_shadows,
    )
    if cfg.update_period:
      # Substeps until the next image of each world, and the image that it holds until then.
      self._wait = self.state(dtype=torch.int64)
      # Until a world that was reset takes a step, it is still being put into its initial state.
      self._at_start = self.state(fill=True, dtype=torch.bool)
      self._held_pos, self._held_mat = self.state((3,), dtype=sim.dtype), self.state((3, 3), dtype=sim.dtype)
      for name, image in vars(self._renderer.images).items():
        if image is not None:
          setattr(self, f"_held_{name}", self.state_of(image))

  def update(self, dt: float) -> None:
    if self.cfg.update_period:
      self._wait -= 1
      self._at_start.fill_(False)

  def reset(self, mask: torch.Tensor) -> None:
    if self.cfg.update_period:
      self._wait.masked_fill_(mask, 0)
      self._at_start |= mask
      # The held images may have to be drawn again though the state is the same.
      self._read_at = None

  @property
  def intrinsic_matrix(self) -> torch.Tensor:
    """K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] of each world, (num_envs, 3, 3) [pixel].

    Coordinates count from the corner of the image to the right and down: its first pixel's centre is (0.5, 0.5).

    Raises:
      MjlabError: the camera is orthographic.
    """
    if self._is_orthographic:
      raise MjlabError(f"{self.label}: camera {self.camera_name!r} is orthographic, and has no intrinsic matrix")
    return self._image_matrix()

  def _image_matrix(self) -> torch.Tensor:
    """Return the intrinsic matrix; of an orthographic camera fx and fy are in pixels per metre."""
    sim, sensor = self.sim, self.sim.mj_model.cam_sensorsize[self._camera]
    if sensor[1] > 0.0 and not self._is_orthographic:
      intrinsic = sim.model.cam_intrinsic[:, self._camera]
      fx, fy, cx, cy = physical_intrinsics(intrinsic, sensor, self.width, self.height)
    else:
      fovy = sim.model.cam_fovy[:, self._camera]
      fx = fy = self.height / (fovy if self._is_orthographic else 2.0 * torch.tan(torch.deg2rad(fovy) / 2.0))
      cx, cy = self.width / 2.0, self.height / 2.0
    matrix = torch.zeros(self.num_envs, 3, 3, dtype=sim.dtype, device=sim.device)
    matrix[:, 0, 0], matrix[:, 1, 1], matrix[:, 2, 2] = fx, fy, 1.0
    matrix[:, 0, 2], matrix[:, 1, 2] = cx, cy
    return matrix

  def debug_draw(self, draw: DebugDraw) -> None:
    """Draw the camera's frame, and a pyramid from it to the corners of its image; an orthographic one as a box."""
    worlds, length = list(draw.worlds), 10.0 * self._draw_size
    _ = self.sim.version
    pos, mat = (value[worlds] for value in self._pose())
    draw.frames(pos, quat_from_matrix(mat), 3.0 * self._draw_size)
    width, height, matrix = self.width, self.height, self._image_matrix()[worlds, None]
    pixel = mat.new_tensor(((0, 0), (width, 0), (width, height), (0, height)))
    image = (pixel - matrix[..., :2, 2]) / matrix[..., (0, 1), (0, 1)] * (1.0 if self._is_orthographic else length)
    local = torch.stack((image[..., 0], -image[..., 1], torch.full_like(image[..., 0], -length)), dim=-1)
    end = pos[:, None] + (mat[:, None] * local[:, :, None]).sum(-1)
    # The camera looks along its negative z axis.
    start = end + length * mat[:, None, :, 2] if self._is_orthographic else pos[:, None].expand_as(end)
    edges = torch.cat((start, end), dim=1), torch.cat((end, end.roll(-1, dims=1)), dim=1)
    draw.lines(edges[0].flatten(0, 1), edges[1].flatten(0, 1), (1.0, 0.8, 0.1, 1.0), 0.1 * self._draw_size)

  def _pose(self) -> tuple[torch.Tensor, torch.Tensor]:
    return self._frame.positions[:, 0], self._frame.rotations[:, 0]

  def _read(self) -> CameraData:
    pos, mat = self._pose()
    period = self.cfg.update_period
    if not period:
      return CameraData(**vars(self._renderer.render()), pos_w=pos, mat_w=mat)
    due = self._at_start | (self._wait <= 0)
    # The next image is due a whole number of periods later.
    torch.sub(period, torch.remainder(-self._wait, period), out=self._wait)
    where_(self._held_pos, due, pos)
    where_(self._held_mat, due, mat)
    return CameraData(**vars(self._renderer.render(due)), pos_w=self._held_pos, mat_w=self._held_mat)
