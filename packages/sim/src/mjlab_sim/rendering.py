"""Images of every world, as the cameras of the model see it: requests and results."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from mjlab_core import Count, PositiveCount

from mjlab_sim.rays import GeomGroups

DataType = Literal["rgb", "depth", "distance", "segmentation"]
Draw = Callable[[int, torch.Tensor | None], None]
"""Draws the worlds of a mask, or all for None. Everything derived is current; it is the same as at the last call if the
version of the simulation, the first argument, is the same."""


@dataclass(frozen=True, kw_only=True)
class View:
  """One image of every world."""

  camera: Count
  width: PositiveCount
  height: PositiveCount
  data_types: tuple[DataType, ...]
  geomgroup: GeomGroups
  """True for each of the six geom groups that is seen, None for all."""
  textures: bool
  shadows: bool

  @property
  def look(self) -> tuple[GeomGroups, bool, bool]:
    """Look of the scene. Views of one look share the tree in which their geoms are found."""
    return self.geomgroup, self.textures, self.shadows


@dataclass(kw_only=True)
class Images:
  """Images that a renderer drew last, the top row first; None for those not asked for. The tensors are its own."""

  rgb: torch.Tensor | None = None
  """Colours, uint8, (num_envs, 3, height, width)."""
  depth: torch.Tensor | None = None
  """Distance along the optical axis, float32, -1 where nothing is seen, (num_envs, 1, height, width) [m]."""
  distance: torch.Tensor | None = None
  """Distance along the ray of the pixel, float32, -1 where nothing is seen, (num_envs, 1, height, width) [m]."""
  segmentation: torch.Tensor | None = None
  """Number and type (`mjtObj`) of the object that is seen, int32, -1 and -1 for none, (num_envs, 2, height, width)."""


_KINDS: dict[DataType, tuple[int, torch.dtype, int]] = {
  "rgb": (3, torch.uint8, 0),
  "depth": (1, torch.float32, -1),
  "distance": (1, torch.float32, -1),
  "segmentation": (2, torch.int32, -1),
}
"""Channels and type of the images of a kind, and their value before the first drawing."""


def blank_images(view: View, num_envs: int, device: torch.device) -> dict[str, torch.Tensor]:
  """Return memory for the images of a view, (num_envs, channels, height, width); empty for kinds not asked for."""
  return {
    kind: torch.full(
      (num_envs, channels, view.height, view.width) if kind in view.data_types else (0, 0, 0, 0),
      empty,
      dtype=dtype,
      device=device,
    )
    for kind, (channels, dtype, empty) in _KINDS.items()
  }
