"""MuJoCo Warp's batch renderer, for both engines: one ray a pixel, in all worlds at once."""

import dataclasses
import itertools
from collections.abc import Hashable, Mapping
from typing import Any

import mujoco
import mujoco_warp as mjw
import torch
import warp as wp

from mjlab_sim.rendering import Draw, View
from mjlab_sim.warp import engine_kernels as kernels
from mjlab_sim.warp.launching import Stage
from mjlab_sim.warp.structs import filled

_PER_VIEW = ("cam_res", "cam_id_map", "rgb_adr", "depth_adr", "seg_adr", "render_rgb", "render_depth", "render_seg")
"""Arrays of a render context that have one entry for each view."""


class Renderers:
  """Views of one stage.

  Args:
    stage: Worlds that are drawn.
  """

  def __init__(self, stage: Stage) -> None:
    self._stage = stage
    self._scenes: dict[Hashable, _Scene] = {}

  def add(self, view: View, images: Mapping[str, torch.Tensor]) -> Draw:
    """Return the function that draws a view into `images`."""
    scene = self._scenes.setdefault(view.look, _Scene(self._stage))
    return WarpRenderer(self._stage, scene, view, images).draw


class _Scene:
  """All geoms of one look in a tree, which follows them, and the views that are searched for in it."""

  _numbers = itertools.count()

  name = ""
  """Name of the graphs; a new one whenever contexts are made, since recordings use the old ones."""

  def __init__(self, stage: Stage) -> None:
    self._stage = stage
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
    views = self._views
    groups, textures, shadows = views[0].look
    with wp.ScopedDevice(self._stage.device):
      whole = mjw.create_render_context(
        self._stage.model,
        nworld=self._stage.num_envs,
        cam_res=[(view.width, view.height) for view in views],
        cam_active=[view.camera for view in views],
        render_rgb=["rgb" in view.data_types for view in views],
        render_depth=["depth" in view.data_types or "distance" in view.data_types for view in views],
        render_seg=["segmentation" in view.data_types for view in views],
        use_textures=textures,
        use_shadows=shadows,
        enabled_geom_groups=[group for group in range(mujoco.mjNGROUP) if groups is None or groups[group]],
        # Rays follow the field of view that a camera has now, in each world.
        use_precomputed_rays=False,
        render_skybox=True,
      )
    # Otherwise the kernel would leave out features that no light of the compiled model has; randomisation may add them.
    whole.light_attenuation_is_default, whole.has_spot_lights = False, True
    self._whole = whole
    self.name = f"scene {next(self._numbers)}"
    self._contexts = [
      dataclasses.replace(
        whole,
        nrender=1,
        total_rays=view.width * view.height,
        **{name: getattr(whole, name)[number : number + 1] for name in _PER_VIEW},
      )
      for number, view in enumerate(views)
    ]


class WarpRenderer:
  """One view of a stage."""

  def __init__(self, stage: Stage, scene: _Scene, view: View, images: Mapping[str, torch.Tensor]) -> None:
    self._stage, self._scene, self._view = stage, scene, view
    self._number = scene.add(view)
    self._arrays: dict[str, Any] = {kind: wp.from_torch(image.flatten(2)) for kind, image in images.items()}
    device = images["rgb"].device
    self._is_due = torch.ones(stage.num_envs, dtype=torch.bool, device=device)
    # Poses of cameras in the worlds that are due. In the others they are far below everything and look down, which
    # costs next to nothing.
    self._aimed = {name: wp.clone(getattr(stage.d, name)) for name in ("cam_xpos", "cam_xmat")}
    self._away = {
      "cam_xpos": torch.tensor([0.0, 0.0, -1e9], device=device),
      "cam_xmat": torch.eye(3, device=device),
    }

  def draw(self, version: int, mask: torch.Tensor | None) -> None:
    """Draw the worlds in a mask, all for None, as they are at a version of the simulation."""
    # Looking at the mask is free on a CPU; a GPU would have to be waited for.
    if mask is not None and mask.device.type == "cpu" and not mask.any():
      return
    context = self._scene.context(self._number, version)
    name = f"{self._scene.name}, view {self._number}"
    if mask is None:
      self._is_due.fill_(True)
      self._stage.run(name, lambda: self._draw(context, self._stage.d))
    else:
      self._is_due.copy_(mask)
      for field, aimed in self._aimed.items():
        pose = wp.to_torch(getattr(self._stage.d, field))
        due = mask.view(-1, *[1] * (pose.ndim - 1))
        wp.to_torch(aimed).copy_(torch.where(due, pose, self._away[field]))
      self._stage.run(f"{name} in part", lambda: self._draw(context, dataclasses.replace(self._stage.d, **self._aimed)))

  def _draw(self, context: Any, d: Any) -> None:
    m, view = self._stage.m, self._view
    mjw.render(m, d, context)
    pictures = filled(
      kernels.Pictures,
      m,
      d,
      context,
      is_due=wp.from_torch(self._is_due),
      camera=view.camera,
      width=view.width,
      height=view.height,
      **self._arrays,
    )
    wp.launch(kernels.unpack_images, dim=(self._stage.num_envs, view.width * view.height), inputs=[pictures])
