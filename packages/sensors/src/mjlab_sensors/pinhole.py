"""Pattern of the rays of a camera's pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import radians, tan
from typing import Annotated, Any, Self

import mujoco
import numpy as np
from mjlab_core import Count, Limits, MjlabError, Positive, check_name

from mjlab_sensors.patterns import RayPatternCfg


def resolution_problems(width: int, height: int, camera: str | None) -> Iterator[str]:
  """Yield a problem if an image has no pixels; zeros take the resolution of `camera`."""
  if (width == 0 or height == 0) and (camera is None or width != height):
    yield f"width and height must be at least 1, got {width} and {height}"


def resolution_of(owner: str, camera: str, resolution: Sequence[int]) -> tuple[int, int]:
  """Return the width and height of a camera of the scene.

  Raises:
    MjlabError: the camera has none.
  """
  width, height = map(int, resolution)
  if width * height <= 1:  # MuJoCo's default.
    raise MjlabError(f"{owner}: camera {camera!r} has no resolution; give width and height")
  return width, height


def physical_intrinsics(intrinsic: Any, sensor: np.ndarray, width: int, height: int) -> tuple[Any, Any, Any, Any]:
  """Return fx, fy, cx and cy of the image of a physical sensor [pixel].

  Args:
    intrinsic: focal lengths and principal point, as in `MjModel.cam_intrinsic`, (..., 4) [m].
    sensor: width and height of the sensor [m].
    width: pixels of a row.
    height: rows.
  """
  # An image of another shape than the sensor's shows the largest part of it that has the image's shape.
  scale = max(width / float(sensor[0]), height / float(sensor[1]))
  fx, fy, left, up = (scale * intrinsic[..., k] for k in range(4))
  # MuJoCo's principal point is an offset from the middle of the image, to the left and up.
  return fx, fy, width / 2.0 - left, height / 2.0 - up


@dataclass(kw_only=True, frozen=True)
class PinholeCameraPatternCfg(RayPatternCfg):
  """One ray through the centre of each pixel of a camera, row by row from the top, each from left to right.

  The order is that of a rendered image: ray `row * width + column` belongs to the pixel `image[row, column]`. As with
  MuJoCo's cameras, the camera looks along the frame's negative z axis, x points right and y up in the image.

  Distances are measured along the rays. The depth of a rendered image is measured along the optical axis: it is the
  distance times -z of the ray's direction.

  Pixel coordinates count from the corner of the image: the centre of its first pixel is (0.5, 0.5), and the middle of
  the image (width / 2, height / 2).
  """

  width: Count = 16
  """Pixels of a row; 0 takes the resolution of `camera`."""
  height: Count = 12
  """Rows; 0 takes the resolution of `camera`."""
  fovy: Annotated[float, Limits(gt=0, lt=180)] = 45.0
  """Vertical field of view of square pixels around the middle of the image [deg]; unused where `focal` is given."""
  focal: tuple[Positive, Positive] | None = None
  """Focal lengths fx and fy [pixel]; None follows from `fovy`."""
  center: tuple[float, float] | None = None
  """Pixel on the optical axis, cx from the image's left and cy from its top [pixel]; None is the middle."""
  camera: str | None = None
  """Full name of a camera of the scene. Its intrinsics replace all fields above except the resolution."""

  @classmethod
  def from_mujoco_camera(cls, camera: str, *, width: int = 0, height: int = 0) -> Self:
    """Return the pixels of a camera of the scene, with its field of view or its physical sensor.

    Args:
      camera: its full name.
      width: pixels of a row, 0 for the camera's own resolution.
      height: rows, 0 for the camera's own resolution.
    """
    return cls(camera=camera, width=width, height=height)

  @classmethod
  def from_intrinsic_matrix(
    cls, matrix: Sequence[float] | Sequence[Sequence[float]] | np.ndarray, *, width: int, height: int
  ) -> Self:
    """Return the pixels of a camera with K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], as 3 x 3 or 9 numbers [pixel].

    Raises:
      MjlabError: the matrix has another shape or other entries.
    """
    k = np.asarray(matrix, dtype=np.float64)
    k = k.reshape(3, 3) if k.size == 9 else k
    if k.shape != (3, 3) or not np.array_equal(k * [[0, 1, 0], [1, 0, 0], [1, 1, 1]], [[0] * 3, [0] * 3, [0, 0, 1]]):
      raise MjlabError(
        "PinholeCameraPatternCfg: an intrinsic matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], without skew, "
        f"got {k.tolist()}"
      )
    focal, center = (float(k[0, 0]), float(k[1, 1])), (float(k[0, 2]), float(k[1, 2]))
    return cls(width=width, height=height, focal=focal, center=center)

  def problems(self) -> Iterator[str]:
    yield from resolution_problems(self.width, self.height, self.camera)
    if self.camera is not None and (self.focal is not None or self.center is not None):
      yield f"camera {self.camera!r} has its own focal and center; leave them out"

  def rays(self) -> tuple[np.ndarray, np.ndarray]:
    focal = self.height / (2.0 * tan(radians(self.fovy) / 2.0))
    fx, fy = self.focal or (focal, focal)
    cx, cy = self.center or (self.width / 2.0, self.height / 2.0)
    column, row = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
    pixels = np.stack(((column - cx) / fx, (cy - row) / fy, -np.ones_like(row)), axis=-1).reshape(-1, 3)
    return np.zeros_like(pixels), pixels / np.linalg.norm(pixels, axis=1, keepdims=True)

  def resolve(self, model: mujoco.MjModel) -> PinholeCameraPatternCfg:
    if self.camera is None:
      return self
    names = [model.camera(camera).name for camera in range(model.ncam)]
    camera = names.index(check_name("camera", self.camera, names, "PinholeCameraPatternCfg"))
    if model.cam_projection[camera] != mujoco.mjtProjection.mjPROJ_PERSPECTIVE:
      raise MjlabError(f"PinholeCameraPatternCfg: camera {self.camera!r} is orthographic, and has no pinhole")
    width, height = self.width, self.height
    if not width:
      width, height = resolution_of("PinholeCameraPatternCfg", self.camera, model.cam_resolution[camera])
    sensor = model.cam_sensorsize[camera]
    if not sensor[1] > 0.0:
      return PinholeCameraPatternCfg(width=width, height=height, fovy=float(model.cam_fovy[camera]))
    fx, fy, cx, cy = map(float, physical_intrinsics(model.cam_intrinsic[camera], sensor, width, height))
    return PinholeCameraPatternCfg(width=width, height=height, focal=(fx, fy), center=(cx, cy))
