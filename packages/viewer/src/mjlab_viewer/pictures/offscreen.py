"""Pictures without a window."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import mujoco
import numpy as np
from mjlab_core import RenderingError
from mjlab_core.config import Config
from mjlab_core.constraints import PositiveCount

from mjlab_viewer.camera import CameraCfg
from mjlab_viewer.drawing.contacts import contact_shapes, embolden
from mjlab_viewer.drawing.mjv import add_to_scene, count_geoms
from mjlab_viewer.pictures.opengl import make_context
from mjlab_viewer.pictures.page_look import look_like_the_page
from mjlab_viewer.snapshot import HostWorld, Snapshot

_SHADOW_REACH = 1.5
"""Half the side of the ground that has shadows, in distances of the camera."""


@dataclass(kw_only=True, frozen=True)
class PictureCfg(Config):
  """Size and content of pictures."""

  width: PositiveCount = 640
  """[px]"""
  height: PositiveCount = 480
  """[px]"""
  camera: CameraCfg = field(default_factory=CameraCfg)
  contacts: bool = False
  """True draws contact points and forces, those of the snapshot if it has them."""
  shadows: bool = True
  geom_groups: tuple[bool, ...] = (True, True, True, False, False, False)
  """MuJoCo's geom groups that are drawn."""
  look: Literal["page", "model"] = "page"
  """Ground, sky and light of the browser page, or those of the model."""


class OffscreenRenderer:
  """Renderer of snapshots: each world is a tile of the picture, and its camera follows its robot.

  Use it only in the thread that made it.

  Args:
    model: The simulation's model; copied.
    cfg: Size and content of pictures.

  Raises:
    RenderingError: OpenGL does not work on this machine, or not for pictures of this size.
    UnknownNameError: The model has no body of the camera's name.
  """

  def __init__(self, model: mujoco.MjModel, cfg: PictureCfg | None = None) -> None:
    self.cfg = PictureCfg() if cfg is None else cfg
    self._world = HostWorld(model)
    model = self._world.model
    model.vis.global_.offwidth, model.vis.global_.offheight = self.cfg.width, self.cfg.height
    # Sharper shadows are not visible in a film, and without a GPU they take most of the time.
    quality = model.vis.quality
    quality.shadowsize = min(quality.shadowsize, 2048)
    # More facets of cylinders and spheres are not visible either.
    quality.numslices, quality.numstacks = min(quality.numslices, 16), min(quality.numstacks, 8)
    if self.cfg.contacts:
      embolden(model, of=model)
    if self.cfg.look == "page":
      look_like_the_page(model)
    self._view = self.cfg.camera.resolve(model)
    self._camera = mujoco.MjvCamera()
    self._options = mujoco.MjvOption()
    self._options.geomgroup[:] = self.cfg.geom_groups
    self._scene = self._new_scene(model.ngeom + 512)
    self._gl = make_context(self.cfg.width, self.cfg.height)
    try:
      context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    except mujoco.FatalError as error:
      self._gl.free()
      raise RenderingError(
        f"a picture of {self.cfg.width} x {self.cfg.height} cannot be drawn on this machine: {error}"
      ) from error
    # The shadow map covers what the camera sees: the nearer the camera, the sharper the shadows.
    context.shadowClip = _SHADOW_REACH * self._view.distance
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
    self._context: mujoco.MjrContext | None = context

  def render(self, snapshot: Snapshot) -> np.ndarray:
    """Return the worlds of a snapshot side by side, (height, width, 3) uint8."""
    assert self._context is not None
    self._gl.make_current()
    for row, rectangle in enumerate(tiles(len(snapshot.worlds), self.cfg.width, self.cfg.height)):
      self._world.load(snapshot, row)
      self._update_scene(snapshot, row)
      mujoco.mjr_render(mujoco.MjrRect(*rectangle), self._scene, self._context)
    pixels = np.empty((self.cfg.height, self.cfg.width, 3), dtype=np.uint8)
    mujoco.mjr_readPixels(pixels, None, mujoco.MjrRect(0, 0, self.cfg.width, self.cfg.height), self._context)
    return np.flipud(pixels).copy()

  def close(self) -> None:
    """Free the OpenGL resources. Calling it again does nothing."""
    if self._context is not None:
      self._gl.make_current()
      self._context.free()
      self._context = None
      self._gl.free()

  def __enter__(self) -> OffscreenRenderer:
    return self

  def __exit__(self, *_: object) -> None:
    self.close()

  def _new_scene(self, maxgeom: int) -> mujoco.MjvScene:
    scene = mujoco.MjvScene(self._world.model, maxgeom=maxgeom)
    scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self.cfg.shadows
    scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
    return scene

  def _update_scene(self, snapshot: Snapshot, row: int) -> None:
    world = self._world
    target = self._view.target(world.data.xpos)
    self._view.aim(self._camera, target)
    drawn = list(snapshot.drawings[row if len(snapshot.drawings) > 1 else 0].shapes)
    if self.cfg.contacts:
      drawn += contact_shapes(world.contacts(snapshot, row), world.model, points=True, forces=True)
    extra = count_geoms(drawn)
    while True:
      mujoco.mjv_updateScene(
        world.model, world.data, self._options, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL, self._scene
      )
      wanted = self._scene.ngeom + extra
      if wanted <= self._scene.maxgeom and not self._scene.status:
        break
      self._scene = self._new_scene(2 * max(wanted, self._scene.maxgeom))
    self._place_shadows(target)
    add_to_scene(self._scene, world.model, drawn)

  def _place_shadows(self, target: np.ndarray) -> None:
    """Center the shadow maps of directional lights on a point; ground that their border cuts casts no shadow.

    Otherwise MuJoCo shows speckles on the triangles that the border cuts.
    """
    model, reach = self._world.model, _SHADOW_REACH * self._view.distance
    is_fixed = model.body_weldid[model.geom_bodyid] == 0
    is_plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    distance = np.linalg.norm(self._world.data.geom_xpos - target, axis=1)
    is_cut = is_fixed & (is_plane | (distance + model.geom_rbound > reach))
    for light in self._scene.lights[: self._scene.nlight]:
      if light.type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL:
        light.pos = target - reach * light.dir
    for geom in self._scene.geoms[: self._scene.ngeom]:
      if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and is_cut[geom.objid]:
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR


def tiles(count: int, width: int, height: int) -> list[tuple[int, int, int, int]]:
  """Return rectangles (left, bottom, width, height) [px] of `count` equal tiles in rows from the top left."""
  columns = math.ceil(math.sqrt(count))
  rows = math.ceil(count / columns)
  lefts = [width * i // columns for i in range(columns + 1)]
  tops = [height - height * i // rows for i in range(rows + 1)]
  return [
    (
      lefts[i % columns],
      tops[i // columns + 1],
      lefts[i % columns + 1] - lefts[i % columns],
      tops[i // columns] - tops[i // columns + 1],
    )
    for i in range(count)
  ]
