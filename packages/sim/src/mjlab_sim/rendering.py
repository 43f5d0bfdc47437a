"""Images of every world, as the cameras of the model see it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

import torch

if TYPE_CHECKING:
  from mjlab_sim.simulation import Simulation

DataType = Literal["rgb", "depth", "distance", "segmentation"]


@dataclass(frozen=True, kw_only=True)
class Look:
  """How a scene is drawn. Views of one look share what it takes to find their geoms."""

  geomgroup: tuple[bool, ...] | None
  """Which of the six geom groups are seen, None for all."""
  textures: bool
  shadows: bool


@dataclass(frozen=True, kw_only=True)
class View:
  """One image of every world."""

  camera: int
  width: int
  height: int
  data_types: tuple[DataType, ...]
  look: Look


@dataclass(kw_only=True)
class Images:
  """What a renderer drew last, the top row first; None for what it was not asked for. The tensors are its own."""

  rgb: torch.Tensor | None
  """Colours, uint8, (num_envs, 3, height, width)."""
  depth: torch.Tensor | None
  """Distance along the optical axis, float32, -1 where nothing is seen, (num_envs, 1, height, width) [m]."""
  distance: torch.Tensor | None
  """Distance along the ray of the pixel, float32, -1 where nothing is seen, (num_envs, 1, height, width) [m]."""
  segmentation: torch.Tensor | None
  """Number and type (`mjtObj`) of the object that is seen, int32, -1 and -1 for none, (num_envs, 2, height, width)."""


class Renderer(Protocol):
  """Draws one image of every world, inside a captured step too."""

  @property
  def images(self) -> Images:
    """What was drawn last; black, and -1, before that."""
    ...

  def render(self, mask: torch.Tensor | None = None) -> Images:
    """Draw the worlds in `mask`, bool (num_envs,), all by default; images of the others stay bit-identical."""
    ...


class EngineRenderer(Protocol):
  """An engine's own renderer."""

  images: Images

  def render(self, epoch: int, mask: torch.Tensor | None) -> None:
    """Draw; everything derived is current, and is what it was at the last call with the same `epoch`."""
    ...


class FreshRenderer:
  """An engine's renderer that sees the written state and the written model."""

  def __init__(self, sim: "Simulation", renderer: EngineRenderer) -> None:
    self._sim = sim
    self._renderer = renderer

  @property
  def images(self) -> Images:
    return self._renderer.images

  def render(self, mask: torch.Tensor | None = None) -> Images:
    if mask is not None:
      self._sim._check_mask(mask, "render")
    self._renderer.render(self._sim.epoch, mask)
    return self._renderer.images
