"""What cameras see: colours, depth, and which object each pixel shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any, get_args

import mujoco
import torch
from mjlab_core import DebugDraw, NameMatchError, Stateful, quat_from_matrix, unknown, where_
from mjlab_sim import DataType

from mjlab_sensors._elements import find_element, names_of
from mjlab_sensors.frames import FrameSet
from mjlab_sensors.sensor import Sensor, SensorCfg

if TYPE_CHECKING:
  from mjlab_core import DebugDraw
  from mjlab_sim import Images, Simulation

_ORTHOGRAPHIC = mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC


@dataclass(kw_only=True)
class CameraSensorCfg(SensorCfg):
  """Images of a camera that the scene has (`camera`), or of a new one that is called like the sensor.

  Several sensors may look through one camera, each with its own size, data and rate.
  """

  camera: str | None = None
  """Full name of a camera of the scene, such as `robot/head`. It is taken as it is: body, pos, quat, fovy and
  orthographic are for a new one."""
  body: str | None = None
  """Full name of the body that a new camera is fixed to; None is the world, in whose coordinates the worlds of a scene
  have their origins apart from one another."""
  pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
  """Where it is in the frame of its body [m]."""
  quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
  """Its orientation (w, x, y, z) in that frame: it looks along its negative z axis, x points right and y up in the
  image."""
  fovy: float | None = None
  """Vertical field of view [deg], by default 45; of an orthographic camera the height of what it sees [m]."""
  orthographic: bool = False
  """Draw a new camera's image with parallel rays."""
  width: int = 0
  """Pixels of a row; 0 takes the resolution of `camera`."""
  height: int = 0
  """Rows; 0 takes the resolution of `camera`."""
  data_types: tuple[DataType, ...] = ("rgb",)
  """What is drawn: "rgb", "depth" along the optical axis, "distance" along each pixel's ray, "segmentation"."""
  update_period: int = 0
  """Physics steps from one image to the next, which is held in between; 0 shows the present state always. A world that
  was reset gets an image at once, and counts from there."""
  geom_groups: tuple[int, ...] | None = (0, 1, 2)
  """Geom groups that are seen; None for all."""
  use_textures: bool = True
  """Draw textures."""
  use_shadows: bool = False
  """Let lights cast shadows."""

  def validate(self) -> None:
    least = 0 if self.camera is not None else 1
    if min(self.width, self.height) < least or (self.width == 0) != (self.height == 0):
      raise ValueError(f"{self.label}: width and height must be at least 1, not {self.width} and {self.height}")
    if not self.data_types:
      raise ValueError(f"{self.label}: data_types must name at least one of: {', '.join(get_args(DataType))}")
    for kind in self.data_types:
      if kind not in get_args(DataType):
        raise ValueError(unknown("data type", kind, get_args(DataType), self.label))
    if self.update_period < 0:
      raise ValueError(f"{self.label}: update_period must be 0 or a number of physics steps, not {self.update_period}")
    groups = self.geom_groups
    if groups is not None and not (groups and all(0 <= group < mujoco.mjNGROUP for group in groups)):
      raise ValueError(f"{self.label}: geom_groups must name groups from 0 to {mujoco.mjNGROUP - 1}, not {groups}")
    if self.camera is not None:
      for field in ("body", "pos", "quat", "fovy", "orthographic"):
        if getattr(self, field) != getattr(CameraSensorCfg, field):
          raise ValueError(f"{self.label}: camera {self.camera!r} is taken as it is; leave {field} out")
    elif self.orthographic and self.fovy is None:
      raise ValueError(f"{self.label}: an orthographic camera needs fovy, the height of what it sees [m]")
    if self.fovy is not None and not 0.0 < self.fovy < (inf if self.orthographic else 180.0):
      bounds = "positive" if self.orthographic else "between 0 and 180 degrees"
      raise ValueError(f"{self.label}: fovy must be {bounds}, not {self.fovy}")
    if not any(self.quat):
      raise ValueError(f"{self.label}: quat must not be zero")

  def _make(self, name: str) -> CameraSensor:
    return CameraSensor(name, self)


@dataclass(kw_only=True)
class CameraData:
  """Images of a `CameraSensor`, the top row first; None for what is not drawn. Tensors are the sensor's own: read them,
  and clone what must outlive the step."""

  rgb: torch.Tensor | None
  """Colours, uint8, (num_envs, 3, height, width)."""
  depth: torch.Tensor | None
  """Distance of what is seen along the optical axis, float32; -1 where nothing is, (num_envs, 1, height, width) [m]."""
  distance: torch.Tensor | None
  """Distance of what is seen from where the ray of its pixel starts, float32; -1 where nothing is,
  (num_envs, 1, height, width) [m]."""
  segmentation: torch.Tensor | None
  """Number and type (`mujoco.mjtObj`) of the object that is seen, int32; -1 and -1 for none,
  (num_envs, 2, height, width)."""
  pos_w: torch.Tensor
  """Where the camera was when it drew them, world frame, (num_envs, 3) [m]."""
  mat_w: torch.Tensor
  """Rotation matrix from the camera to the world then; it looks along its negative z axis, (num_envs, 3, 3)."""

  @property
  def rgb_float(self) -> torch.Tensor | None:
    """Colours from 0 to 1, float32, computed when asked for, (num_envs, 3, height, width)."""
    return None if self.rgb is None else self.rgb / 255.0

  @property
  def quat_w(self) -> torch.Tensor:
    """Orientation (w, x, y, z) of the camera, world frame, computed when asked for, (num_envs, 4)."""
    return quat_from_matrix(self.mat_w)


class _Shutter(Stateful):
  """When each world's next image is due, and the image that it holds until then."""

  def __init__(self, period: int, images: Images, pos: torch.Tensor, mat: torch.Tensor) -> None:
    self.num_envs = len(pos)
    self._period = period
    self._wait = torch.zeros(self.num_envs, dtype=torch.int64, device=pos.device)
    # Until a world that was reset takes a step, it is still being put into its initial state.
    self._at_start = torch.ones(self.num_envs, dtype=torch.bool, device=pos.device)
    self._pos, self._mat = torch.zeros_like(pos), torch.zeros_like(mat)
    self._rgb, self._depth, self._distance = images.rgb, images.depth, images.distance
    self._segmentation = images.segmentation

  def step(self) -> None:
    self._wait -= 1
    self._at_start.fill_(False)

  def reset(self, mask: torch.Tensor) -> None:
    self._wait.masked_fill_(mask, 0)
    self._at_start |= mask

  def open(self) -> torch.Tensor:
    """Which worlds are to be drawn, bool (num_envs,); their next image is due a whole number of periods later."""
    due = self._at_start | (self._wait <= 0)
    torch.sub(self._period, torch.remainder(-self._wait, self._period), out=self._wait)
    return due

  def pose(self, due: torch.Tensor, pos: torch.Tensor, mat: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Where the camera was when each world was drawn."""
    where_(self._pos, due, pos)
    where_(self._mat, due, mat)
    return self._pos, self._mat


class CameraSensor(Sensor[CameraData]):
  """Images of one camera in all worlds, drawn together by MuJoCo Warp's renderer, on a CPU too.

  They are drawn when the data are first asked for after a change of state, in the worlds that are due. Textures,
  colours, lights, sizes of geoms, poses and fields of view are those of each world. Surfaces are seen from outside
  only, so that a camera looks out through the shell that it is built into, and nothing is seen beyond the model's far
  plane, `vis.map.zfar * stat.extent`. Of a height field the surface is seen, without its walls.
  """

  _children = ("_shutter",)
  cfg: CameraSensorCfg

  def __init__(self, name: str, cfg: CameraSensorCfg) -> None:
    super().__init__(name, cfg)
    self.camera_name = name if cfg.camera is None else cfg.camera
    """Full name of the camera."""
    self.width, self.height = cfg.width, cfg.height
    self._shutter: _Shutter | None = None

  def edit_spec(self, spec: mujoco.MjSpec, entities: Mapping[str, Any]) -> None:
    cfg, cameras = self.cfg, names_of(spec, "camera")
    if cfg.camera is not None:
      if cfg.camera not in cameras:
        raise NameMatchError(unknown("camera", cfg.camera, cameras, self.label))
      if not self.width:
        self.width, self.height = (int(pixels) for pixels in spec.camera(cfg.camera).resolution)
        if self.width * self.height <= 1:  # What MuJoCo compiles where none is given.
          raise ValueError(f"{self.label}: camera {cfg.camera!r} has no resolution; give width and height")
      return
    if self.name in cameras:
      raise ValueError(
        f"{self.label}: the scene already has a camera of this name; "
        f"use CameraSensorCfg(camera={self.name!r}), or another name"
      )
    body = "world"
    if cfg.body is not None:
      body = find_element(spec, entities, "body", cfg.body, entity=None, owner=self.label)
    camera = spec.body(body).add_camera(
      name=self.name, pos=cfg.pos, quat=cfg.quat, resolution=(self.width, self.height)
    )
    if cfg.fovy is not None:
      camera.fovy = cfg.fovy
    if cfg.orthographic:
      camera.proj = _ORTHOGRAPHIC

  def initialize(self, sim: Simulation, entities: Mapping[str, Any]) -> None:
    super().initialize(sim, entities)
    cfg = self.cfg
    self._frame = FrameSet(sim, "camera", (self.camera_name,), self.label)
    self._camera = mujoco.mj_name2id(sim.mj_model, mujoco.mjtObj.mjOBJ_CAMERA, self.camera_name)
    groups = cfg.geom_groups
    self._renderer = sim.make_renderer(
      self._camera,
      self.width,
      self.height,
      cfg.data_types,
      geomgroup=None if groups is None else [group in groups for group in range(mujoco.mjNGROUP)],
      textures=cfg.use_textures,
      shadows=cfg.use_shadows,
    )
    if cfg.update_period:
      self._shutter = _Shutter(cfg.update_period, self._renderer.images, *self._pose())

  def update(self, dt: float) -> None:
    del dt
    if self._shutter is not None:
      self._shutter.step()

  def reset(self, mask: torch.Tensor) -> None:
    if self._shutter is not None:
      self._shutter.reset(mask)
      # What is held may have to be drawn anew though the state is the same.
      self._read_at = None

  @property
  def intrinsic_matrix(self) -> torch.Tensor:
    """K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] of each world, (num_envs, 3, 3) [pixel].

    Coordinates count from the corner of the image to the right and down: its first pixel's centre is (0.5, 0.5).

    Raises:
      ValueError: the camera is orthographic.
    """
    sim, model = self.sim, self.sim.mj_model
    if model.cam_projection[self._camera] == _ORTHOGRAPHIC:
      raise ValueError(f"{self.label}: camera {self.camera_name!r} is orthographic, and has no intrinsic matrix")
    sensor = model.cam_sensorsize[self._camera]
    if sensor[1] > 0.0:
      # An image of another shape than the sensor's shows the largest part of it that has the image's shape.
      scale = max(self.width / float(sensor[0]), self.height / float(sensor[1]))
      fx, fy, left, up = (scale * sim.model.cam_intrinsic[:, self._camera]).unbind(-1)
    else:
      half = torch.deg2rad(sim.model.cam_fovy[:, self._camera]) / 2.0
      fx = fy = self.height / (2.0 * torch.tan(half))
      left = up = torch.zeros_like(half)
    matrix = torch.zeros(self.num_envs, 3, 3, dtype=sim.dtype, device=sim.device)
    matrix[:, 0, 0], matrix[:, 1, 1], matrix[:, 2, 2] = fx, fy, 1.0
    matrix[:, 0, 2], matrix[:, 1, 2] = self.width / 2.0 - left, self.height / 2.0 - up
    return matrix

  def debug_draw(self, draw: DebugDraw) -> None:
    """Show where the camera is, and a pyramid from it to the corners of its image; an orthographic one as a box."""
    sim, worlds, length = self.sim, list(draw.worlds), 10.0 * self._draw_size
    _ = sim.epoch
    pos, mat = (value[worlds] for value in self._pose())
    draw.frames(pos, quat_from_matrix(mat), 3.0 * self._draw_size)
    corner = torch.tensor(((0, 0), (1, 0), (1, 1), (0, 1)), dtype=sim.dtype, device=sim.device)
    pixel = corner * corner.new_tensor((self.width, self.height))
    if sim.mj_model.cam_projection[self._camera] == _ORTHOGRAPHIC:
      metres = sim.model.cam_fovy[:, self._camera].expand(self.num_envs)[worlds, None, None] / self.height
      near = (pixel - corner.new_tensor((self.width, self.height)) / 2.0) * metres
      far = near
    else:
      matrix = self.intrinsic_matrix[worlds]
      focal, center = matrix[:, None, (0, 1), (0, 1)], matrix[:, None, :2, 2]
      far = (pixel - center) / focal * length
      near = torch.zeros_like(far)

    def place(image: torch.Tensor, depth: float) -> torch.Tensor:
      point = torch.stack((image[..., 0], -image[..., 1], torch.full_like(image[..., 0], -depth)), dim=-1)
      return pos[:, None] + (mat[:, None] * point[:, :, None]).sum(-1)

    start, end = place(near, 0.0), place(far, length)
    edges = torch.cat((start, end), dim=1), torch.cat((end, end.roll(-1, dims=1)), dim=1)
    draw.lines(edges[0].flatten(0, 1), edges[1].flatten(0, 1), (1.0, 0.8, 0.1, 1.0), 0.1 * self._draw_size)

  def _pose(self) -> tuple[torch.Tensor, torch.Tensor]:
    return self._frame.positions[:, 0], self._frame.rotations[:, 0]

  def _read(self) -> CameraData:
    pose = self._pose()
    if self._shutter is None:
      images = self._renderer.render()
    else:
      due = self._shutter.open()
      images = self._renderer.render(due)
      pose = self._shutter.pose(due, *pose)
    return CameraData(**vars(images), pos_w=pose[0], mat_w=pose[1])
