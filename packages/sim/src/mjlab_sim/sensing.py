"""Rays and images of the state and the model as they are written."""

import mujoco
import numpy as np
import torch

from mjlab_sim.freshness import Freshness
from mjlab_sim.rays import RayHits, Rays, RayTargets, fixed_bodies, fixed_geoms
from mjlab_sim.rendering import Images, View
from mjlab_sim.step_graph import Recordings
from mjlab_sim.tensors import versions


class RayCaster:
  """A fixed number of rays in every world; casts inside a recorded step too. Made by `Simulation.make_ray_caster`."""

  def __init__(self, fresh: Freshness, ground: "FixedGeometry", targets: RayTargets, rays: Rays) -> None:
    self._fresh, self._ground, self._hits = fresh, ground, rays.hits
    self._cast = fresh.engine.ray_caster(targets, rays)
    self.origins = rays.origins
    """Starts of the rays of the next cast, world frame, (num_envs, num_rays, 3) [m]; write it in place."""
    self.directions = rays.directions
    """Unit directions of the rays of the next cast, world frame, (num_envs, num_rays, 3); write it in place."""

  def cast(self, origins: torch.Tensor | None = None, directions: torch.Tensor | None = None) -> RayHits:
    """Cast the rays in `origins` and `directions`; arguments are written there first."""
    for given, rays in ((origins, self.origins), (directions, self.directions)):
      if given is not None:
        rays.copy_(given)
    self._fresh.refresh()
    self._fresh.num_sensed += 1
    self._cast(self._ground.is_in_place())
    return self._hits


class Renderer:
  """One image of every world; draws inside a recorded step too. Made by `Simulation.make_renderer`."""

  def __init__(self, fresh: Freshness, view: View, images: dict[str, torch.Tensor]) -> None:
    self._fresh = fresh
    self._draw = fresh.engine.renderer(view, images)
    self.images = Images(**{kind: image for kind, image in images.items() if kind in view.data_types})
    """Images that were drawn last; black, and -1, before that."""

  def render(self, mask: torch.Tensor | None = None) -> Images:
    """Draw the worlds in `mask`, bool (num_envs,), all by default; images of the others stay bit-identical.

    Raises:
      MjlabError: The mask has another shape or type.
    """
    if mask is not None:
      self._fresh.check_mask(mask, "render")
    self._fresh.refresh()
    self._fresh.num_sensed += 1
    self._draw(self._fresh.version, mask)
    return self.images


class FixedGeometry:
  """Watch over the geoms that never move: rays find them in a tree while all are in their compiled places.

  Args:
    model: The compiled model.
    fresh: The worlds.
    recordings: Step graphs, which are recorded again when the geometry moves or returns.
  """

  _FIELDS = ("geom_pos", "geom_quat", "geom_size", "geom_dataid", "body_pos", "body_quat")

  def __init__(self, model: mujoco.MjModel, fresh: Freshness, recordings: Recordings) -> None:
    self._fresh, self._recordings = fresh, recordings
    self._compiled: dict[str, tuple[torch.Tensor, torch.Tensor]] = {}
    for name in self._FIELDS:
      now = fresh.engine.model_field(name)
      rows = np.flatnonzero(fixed_geoms(model) if name.startswith("geom") else fixed_bodies(model))
      values = torch.as_tensor(getattr(model, name)[rows], dtype=now.dtype, device=now.device)
      self._compiled[name] = torch.as_tensor(rows, device=now.device), values
    self._version: int | None = None
    self._is_in_place = True

  def forget(self) -> None:
    """Look again at the next chance: the memory of a field was replaced."""
    self._version = None

  def is_in_place(self) -> bool:
    """Return True if nothing has moved.

    Written fields are read once, but not inside a recording: there they are not trusted.
    """
    fields = {name: self._fresh.engine.model_field(name) for name in self._compiled}
    version = versions(fields.values())
    if version != self._version:
      if self._recordings.recorder is not None:
        return False
      self._version = version
      before = self._is_in_place
      self._is_in_place = all(
        bool((fields[name].index_select(1, index) == values).all()) for name, (index, values) in self._compiled.items()
      )
      if self._is_in_place != before:
        self._recordings.invalidate()
    return self._is_in_place
