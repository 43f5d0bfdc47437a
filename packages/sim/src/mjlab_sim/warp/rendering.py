"""MuJoCo Warp's batch renderer, for both engines: one ray a pixel, in all worlds at once."""

import itertools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import mujoco
import mujoco_warp as mjw
import torch
import warp as wp

from mjlab_sim.rendering import EngineImages, Images, Look, View
from mjlab_sim.warp import engine_kernels as kernels
from mjlab_sim.warp.launching import Stage

POSES = ("geom_xpos", "geom_xmat", "cam_xpos", "cam_xmat", "light_xpos", "light_xdir", "flexvert_xpos")
"""Fields of the data that MuJoCo Warp's renderer reads."""
_PER_VIEW = ("cam_res", "cam_id_map", "rgb_adr", "depth_adr", "seg_adr", "render_rgb", "render_depth", "render_seg")
"""Arrays of a render context that have one entry for each view."""


class Renderers:
  """Views of one stage.

  Args:
    stage: Worlds that are drawn.
  """

  def __init__(self, stage: Stage) -> None:
    self._stage = stage
    self._scenes: dict[Look, _Scene] = {}

  def add(self, view: View) -> EngineImages:
    """Return images of a view, and the function that draws them."""
    scene = self._scenes.setdefault(view.look, _Scene(self._stage, view.look))
    renderer = WarpRenderer(self._stage, scene, view)
    return EngineImages(images=renderer.images, draw=renderer.draw)


class _Scene:
  """All geoms of one look in a tree, which follows them, and the views that are searched for in it."""

  _numbers = itertools.count()

  name = ""
  """Another one whenever contexts are made: what was recorded with the old ones is not for them."""

  def __init__(self, stage: Stage, look: Look) -> None:
    self._stage, self._look = stage, look
    self._views: list[View] = []
    self._contexts: list[Any] = []
    self._version = -1

  def add(self, view: View) -> int:
    """Return the number of the new view; contexts are made again with the next image."""
    self._views.append(view)
    self._contexts.clear()
    return len(self._views) - 1

  def context(self, number: int, version: int) -> Any:
    """Return the context with which `mujoco_warp.render` draws one view, with the tree as it is at `version`."""
    if not self._contexts:
      self._build()
      self._version = -1
    if version != self._version:
      self._version = version
      stage, whole = self._stage, self._whole
      stage.refresh()
      stage.run(self.name, lambda: mjw.refit_bvh(stage.m, stage.d, whole))
    return self._contexts[number]

  def _build(self) -> None:
    views, groups = self._views, self._look.geomgroup
    wants = {kind: [kind in view.data_types for view in views] for kind in ("rgb", "segmentation")}
    wants["depth"] = ["depth" in view.data_types or "distance" in view.data_types for view in views]
    with wp.ScopedDevice(self._stage.device):
      whole = mjw.create_render_context(
        self._stage.model,
        nworld=self._stage.num_envs,
        cam_res=[(view.width, view.height) for view in views],
        cam_active=[view.camera for view in views],
        render_rgb=wants["rgb"],
        render_depth=wants["depth"],
        render_seg=wants["segmentation"],
        use_textures=self._look.textures,
        use_shadows=self._look.shadows,
        enabled_geom_groups=[group for group in range(mujoco.mjNGROUP) if groups is None or groups[group]],
        # Rays follow the field of view that a camera has now, in each world.
        use_precomputed_rays=False,
        render_skybox=True,
      )
    # What is left out of the kernel because no light of the compiled model has it could not be randomised later.
    whole.light_attenuation_is_default, whole.has_spot_lights = False, True
    self._whole = whole
    self.name = f"scene {next(self._numbers)}"
    self._contexts = [
      replace(
        whole,
        nrender=1,
        total_rays=view.width * view.height,
        **{name: getattr(whole, name)[number : number + 1] for name in _PER_VIEW},
      )
      for number, view in enumerate(views)
    ]


class WarpRenderer:
  """One view of a stage."""

  def __init__(self, stage: Stage, scene: _Scene, view: View) -> None:
    self._stage, self._scene, self._view = stage, scene, view
    self._number = scene.add(view)
    worlds, pixels = stage.num_envs, view.width * view.height
    with wp.ScopedDevice(stage.device):

      def image(kind: str, channels: int, dtype: Any, value: int) -> Any:
        return wp.full((worlds, channels, pixels if kind in view.data_types else 0), value, dtype=dtype)

      self._rgb = image("rgb", 3, wp.uint8, 0)
      self._depth = image("depth", 1, wp.float32, -1)
      self._distance = image("distance", 1, wp.float32, -1)
      self._segmentation = image("segmentation", 2, wp.int32, -1)
      self._is_due: Any = wp.ones(worlds, dtype=wp.bool)
      # Poses of cameras in the worlds that are due. In the others they look away, which costs next to nothing.
      self._cam_xpos: Any = wp.zeros((worlds, stage.model.ncam), dtype=wp.vec3)
      self._cam_xmat: Any = wp.zeros((worlds, stage.model.ncam), dtype=wp.mat33)
    self._is_due_torch = wp.to_torch(self._is_due)

    def tensor(array: Any) -> torch.Tensor | None:
      return wp.to_torch(array).unflatten(2, (view.height, view.width)) if array.size else None

    self.images = Images(
      rgb=tensor(self._rgb),
      depth=tensor(self._depth),
      distance=tensor(self._distance),
      segmentation=tensor(self._segmentation),
    )

  def draw(self, version: int, mask: torch.Tensor | None) -> None:
    """Draw the worlds in a mask, all for None, as they are at a version of the simulation."""
    # On a CPU it costs nothing to see that no world is to be drawn; a GPU would have to be waited for.
    if mask is not None and mask.device.type == "cpu" and not mask.any():
      return
    context = self._scene.context(self._number, version)
    name = f"{self._scene.name}, view {self._number}"
    if mask is None:
      self._is_due_torch.fill_(True)
      self._stage.run(name, lambda: self._draw(context, self._stage.d))
    else:
      self._is_due_torch.copy_(mask)
      self._stage.run(f"{name} in part", lambda: self._draw_due(context))

  def _draw_due(self, context: Any) -> None:
    d = self._stage.d
    wp.launch(
      kernels.aim_cameras,
      dim=self._cam_xpos.shape,
      inputs=[self._is_due, d.cam_xpos, d.cam_xmat],
      outputs=[self._cam_xpos, self._cam_xmat],
      device=self._stage.device,
    )
    poses = {name: getattr(d, name) for name in POSES}
    poses |= {"cam_xpos": self._cam_xpos, "cam_xmat": self._cam_xmat}
    self._draw(context, SimpleNamespace(nworld=d.nworld, **poses))

  def _draw(self, context: Any, d: Any) -> None:
    m, view = self._stage.m, self._view
    mjw.render(m, d, context)
    wp.launch(
      kernels.unpack_images,
      dim=(self._stage.num_envs, view.width * view.height),
      inputs=[
        self._is_due,
        *(context.rgb_data, context.depth_data, context.seg_data),
        *(context.rgb_adr, context.depth_adr, context.seg_adr),
        *(m.cam_projection, m.cam_fovy, m.cam_sensorsize, m.cam_intrinsic),
        *(view.camera, view.width, view.height, context.znear),
      ],
      outputs=[self._rgb, self._depth, self._distance, self._segmentation],
      device=self._stage.device,
    )
