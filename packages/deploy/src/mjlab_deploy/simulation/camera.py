"""Images of a bundle's cameras, drawn by MuJoCo's own renderer. They need OpenGL, but no screen."""

import contextlib
import importlib
import os
import sys
from typing import Any

import mujoco
import numpy as np

from mjlab_deploy.description import Description, Input
from mjlab_deploy.errors import DeployError
from mjlab_deploy.simulation.model_readings import CAMERA, Readings

_FAR = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
# OpenGL limits the light on a texture to 1, the training does not. Images are drawn darker by this factor.
_DARKER = 2.0
# Half the length and width of a plane that is drawn in small squares, and their size [m].
_NEAR = (3.0, 3.0, 0.03)


class Cameras:
  """Inputs of a policy that are images of cameras in a MuJoCo model.

  Args:
    model: The model.
    description: Contents of `bundle.json`.

  Raises:
    DeployError: The model lacks a camera that an input names, or OpenGL does not work here.
  """

  def __init__(self, model: mujoco.MjModel, description: Description) -> None:
    self.inputs: list[Input] = [
      item for item in description.inputs if item.origin is not None and item.origin.quantity in CAMERA
    ]
    self._views = [_View(model, item, is_floating=description.robot.is_floating) for item in self.inputs]

  def draw(self, data: mujoco.MjData) -> Readings:
    """Return the images of a state whose positions are computed, as the training has them."""
    return {item.name: view.draw(data) for item, view in zip(self.inputs, self._views, strict=True)}


class _View:
  def __init__(self, model: mujoco.MjModel, item: Input, *, is_floating: bool) -> None:
    origin = item.origin
    assert origin is not None
    camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, origin.name)
    is_depth = origin.quantity == "camera_depth"
    if camera < 0 or len(item.shape) != 3 or item.shape[0] != (1 if is_depth else 3):
      raise DeployError(f"input '{item.name}': scene.xml has no camera '{origin.name[:60]}' for such an image")
    _, height, width = item.shape
    self._model, self._is_depth, self._shape = model, is_depth, (height, width)
    # The training casts one ray through the middle of each pixel.
    model.vis.quality.offsamples = 0
    if not is_floating:
      # OpenGL lights corners, the training pixels. A robot that stays sees only the near part of an endless plane.
      endless = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_size[:, 0] == 0.0)
      model.geom_size[endless] = _NEAR
    size = model.cam_sensorsize[camera]
    if size[1] > 0.0:
      # An image of another shape than the sensor's shows the largest part of it that has the image's shape.
      size[:] = np.array((width, height)) / max(width / size[0], height / size[1])
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)
    self._opengl = _opengl(width, height)
    self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
    self._context.readDepthMap = int(_FAR)
    self._scene = mujoco.MjvScene(model, model.ngeom + 100)
    for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
      self._scene.flags[flag] = False
    self._camera, self._option = mujoco.MjvCamera(), mujoco.MjvOption()
    self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED.value, camera
    self._option.geomgroup[:] = [not origin.geom_groups or group in origin.geom_groups for group in range(6)]
    self._option.sitegroup[:] = False

  def __del__(self) -> None:
    # OpenGL frees objects of the current context only.
    with contextlib.suppress(Exception):
      self._opengl.make_current()
      self._context.free()
      self._opengl.free()

  def draw(self, data: mujoco.MjData) -> np.ndarray:
    height, width = self._shape
    self._opengl.make_current()
    mujoco.mjv_updateScene(
      self._model, data, self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
    )
    area = mujoco.MjrRect(0, 0, width, height)
    scene, colours, buffer = self._scene, np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
    if not self._is_depth:
      for light in scene.lights[: scene.nlight]:
        for values in (light.ambient, light.diffuse, light.specular):
          values /= _DARKER
      for geom in scene.geoms[: scene.ngeom]:
        geom.emission /= _DARKER
    mujoco.mjr_render(area, scene, self._context)
    mujoco.mjr_readPixels(colours, buffer, area, self._context)
    if not self._is_depth:
      # The background is not lit.
      lit = colours * np.where(buffer > 0.0, np.float32(_DARKER), np.float32(1.0))[..., None] / np.float32(255.0)
      return np.ascontiguousarray(np.minimum(lit, 1.0)[::-1].transpose(2, 0, 1))
    extent, planes = self._model.stat.extent, self._model.vis.map
    near, far = planes.znear * extent, planes.zfar * extent
    # The buffer is 1 at the near plane and 0 at the far one, the background.
    share = buffer[::-1].astype(float)
    depth = near * far / (near + share * (far - near))
    return np.where(share > 0.0, depth, -1.0).astype(np.float32)[None]


def _opengl(width: int, height: int) -> Any:
  """Return an OpenGL context of MuJoCo's, current in this thread."""
  chosen = os.environ.get("MUJOCO_GL", "").lower().strip()
  if chosen in ("disable", "disabled", "off", "false", "0"):
    raise DeployError(f"no camera images: MUJOCO_GL={chosen} switches OpenGL off")
  known = {"linux": ("egl", "osmesa", "glfw"), "darwin": ("cgl",)}.get(sys.platform, ("glfw",))
  _load_triton()
  failures = []
  for name in (chosen,) if chosen in known else known:
    if name == "glfw" and sys.platform == "linux" and not os.environ.get("DISPLAY"):
      continue
    try:
      context = importlib.import_module(f"mujoco.{name}").GLContext(width, height)
      context.make_current()
    except Exception as error:
      # A missing driver makes PyOpenGL raise AttributeError, ImportError or its own errors.
      failures.append(f"{name}: {' '.join(str(error).split())[:100] or type(error).__name__}")
    else:
      return context
  raise DeployError(f"no camera images: OpenGL fails on this machine ({'; '.join(failures)})")


def _load_triton() -> None:
  # Software OpenGL and torch's compiler both bring an LLVM, and a Triton that is loaded after OpenGL's crashes.
  with contextlib.suppress(ImportError):
    importlib.import_module("triton")
