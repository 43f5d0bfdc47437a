"""Where the eye is: one meaning in the browser, in the window and in pictures."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mjlab_viewer.errors import ViewerError


@dataclass(kw_only=True, frozen=True)
class CameraCfg:
  """An eye that looks at a point, MuJoCo's angles. By default it follows the robot."""

  distance: float | None = None
  """From the eye to the point [m]; None: the size of the model and a quarter."""
  azimuth: float = 120.0
  """Direction of sight about the world's z axis [deg]; at 0 one looks along +x, at 90 along +y."""
  elevation: float = -20.0
  """Direction of sight above the horizon [deg]; below zero one looks down."""
  body: str | None = None
  """Name of the body that is followed; None: the first body that moves, or else the middle of the model.

  Of one that only others move, such as the base of an arm, what is looked at is a quarter of the model's size above it.
  """
  lookat: tuple[float, float, float] | None = None
  """A fixed point of the world to look at instead [m]."""

  def resolve(self, model: mujoco.MjModel) -> Camera:
    """The camera for a model.

    Raises:
      ViewerError: the model has no such body.
    """
    if self.body is not None:
      body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, self.body)
      if body < 0:
        names = ", ".join(model.body(i).name for i in range(1, model.nbody))
        raise ViewerError(f"camera: body '{self.body}' does not exist; the model has: {names}")
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
  """A camera for one model: it looks at a body or at a point."""

  distance: float
  azimuth: float
  elevation: float
  body: int | None
  above: float
  lookat: tuple[float, float, float] | None

  def target(self, xpos: np.ndarray) -> np.ndarray:
    """The point looked at, (3,) [m], where bodies are at `xpos`, (nbody, 3) [m]."""
    if self.lookat is not None:
      return np.array(self.lookat, dtype=float)
    assert self.body is not None
    return xpos[self.body] + np.array([0.0, 0.0, self.above])

  @property
  def offset(self) -> np.ndarray:
    """From the point looked at to the eye, (3,) [m]."""
    azimuth, elevation = np.deg2rad(self.azimuth), np.deg2rad(self.elevation)
    sight = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    return -self.distance * sight

  def aim(self, camera: mujoco.MjvCamera, target: np.ndarray) -> None:
    """Set one of MuJoCo's free cameras to look at `target`, (3,) [m]."""
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = target
    camera.distance, camera.azimuth, camera.elevation = self.distance, self.azimuth, self.elevation


def first_moving_body(model: mujoco.MjModel) -> int:
  """The first body that can move, 0 if there is none."""
  for body in range(1, model.nbody):
    if model.body_weldid[body] != 0 or model.body_mocapid[model.body_rootid[body]] >= 0:
      return body
  return 0
