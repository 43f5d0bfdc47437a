"""Camera, the same in the browser, in the window and in pictures."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from mjlab_core.config import Config
from mjlab_core.names import check_name


@dataclass(kw_only=True, frozen=True)
class CameraCfg(Config):
  """Camera that looks at a point, with MuJoCo's angles. By default it follows the robot."""

  distance: float | None = None
  """Distance from the camera to the point [m]; None is 1.25 times the size of the model."""
  azimuth: float = 120.0
  """Direction of view about the world's z axis [deg]; 0 looks along +x, 90 along +y."""
  elevation: float = -20.0
  """Direction of view above the horizon [deg]; negative values look down."""
  body: str | None = None
  """Name of the body that is followed; None is the first body that moves, or else the middle of the model.

  Above a mocap body, such as the base of an arm, the camera looks at a point a quarter of the model's size higher.
  """
  lookat: tuple[float, float, float] | None = None
  """Fixed point of the world to look at instead [m]."""

  def resolve(self, model: mujoco.MjModel) -> Camera:
    """Return the camera for a model.

    Raises:
      UnknownNameError: The model has no such body.
    """
    if self.body is not None:
      names = [model.body(i).name for i in range(model.nbody)]
      body = names.index(check_name("body", self.body, names, "camera"))
    else:
      body = first_moving_body(model)
    distance = 1.25 * float(model.stat.extent) if self.distance is None else self.distance
    lookat = self.lookat
    if lookat is None and body == 0:
      x, y, z = map(float, model.stat.center)
      lookat = (x, y, z)
    is_base = self.body is None and bool(model.body_mocapid[body] >= 0)
    return Camera(
      distance=distance,
      azimuth=self.azimuth,
      elevation=self.elevation,
      body=body if lookat is None else None,
      above=0.25 * float(model.stat.extent) if is_base else 0.0,
      lookat=lookat,
    )


@dataclass(kw_only=True, frozen=True)
class Camera:
  """Camera for one model; it looks at a body or at a point."""

  distance: float
  azimuth: float
  elevation: float
  body: int | None
  above: float
  lookat: tuple[float, float, float] | None

  def target(self, xpos: np.ndarray) -> np.ndarray:
    """Return the point looked at, (3,) [m], for bodies at `xpos`, (nbody, 3) [m]."""
    if self.lookat is not None:
      return np.array(self.lookat, dtype=float)
    assert self.body is not None
    return xpos[self.body] + np.array([0.0, 0.0, self.above])

  @property
  def offset(self) -> np.ndarray:
    """Vector from the point looked at to the camera, (3,) [m]."""
    azimuth, elevation = np.deg2rad(self.azimuth), np.deg2rad(self.elevation)
    sight = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    return -self.distance * sight

  def aim(self, camera: mujoco.MjvCamera, target: np.ndarray) -> None:
    """Set one of MuJoCo's free cameras to look at `target`, (3,) [m]."""
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = target
    camera.distance, camera.azimuth, camera.elevation = self.distance, self.azimuth, self.elevation


def first_moving_body(model: mujoco.MjModel) -> int:
  """Return the first body that can move, 0 if none can."""
  for body in range(1, model.nbody):
    if model.body_weldid[body] != 0 or model.body_mocapid[model.body_rootid[body]] >= 0:
      return body
  return 0
